"""From the states of a run to one artifact: autoencoder, clusters, classifier, statistics and pictures."""

import hashlib
import json
import logging
import platform
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uavrl.errors import UavrlError, extras
from uavrl.models import PSAE, OneShotClassifier, TrajectoryClassifier
from uavrl.pretraining.clustering import Clusters, cluster, cluster_each, draw, elbow, standardization
from uavrl.pretraining.networks import predict, train_classifier, train_psae
from uavrl.pretraining.settings import PretrainConfig, PretrainRecipe
from uavrl.pretraining.states import States, read_states, triple_centres
from uavrl.runs.episodes import OUTCOMES
from uavrl.runs.names import PRETRAINED
from uavrl.runs.weights import ARTIFACT
from uavrl_onboard.files import writable
from uavrl_onboard.pluralize import pluralize

with extras():
    from threadpoolctl import threadpool_limits

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StateSample:
    """The states for training.

    Attributes:
        index: ``[n]``, ascending, which of the run's states.
        centres: ``[m]``, those of them that have a neighbour on both sides.
        held_out: ``[n]`` boolean, those of the episodes that the classifier does not learn from.
    """

    index: np.ndarray
    centres: np.ndarray
    held_out: Tensor


def pretrain(config: PretrainConfig) -> dict[str, Any]:
    """Makes the artifact; returns the content of ``artifact.json`` and the folder."""
    if config.run is None:
        raise UavrlError("Give run=RUN_FOLDER, of a training whose states are learned from: uavrl-train makes one.")
    torch.set_num_threads(config.threads)
    output = Path(config.output or Path(config.run) / PRETRAINED)
    if any((output / name).exists() for name in (ARTIFACT.json, ARTIFACT.safetensors)):
        raise UavrlError(f"The folder {output} already contains an artifact: choose another with output=FOLDER.")
    source = read_states(Path(config.run))
    sample = draw_sample(source, config.pretrain, config.seed)
    writable(output / ARTIFACT.json, "output=FOLDER")
    with threadpool_limits(config.threads):
        about = _pretrain(source, sample, config, output)
    return {**about, "output": str(output)}


def draw_sample(source: States, recipe: PretrainRecipe, seed: int) -> StateSample:
    """Draws states at random, each with the same probability, and the episodes that are held out."""
    total, episodes = len(source), len(source.outcomes)
    count = min(recipe.states, total)
    if count < recipe.largest_k:
        raise UavrlError(
            f"Expected at least as many states as clusters ({recipe.largest_k}), got {count} of the {total} in "
            f"{source.name}: train longer, or lower pretrain.clusters, k and compare_k."
        )
    if episodes < 2:
        raise UavrlError(f"Expected 2 or more episodes in {source.name}, found {episodes}: train longer.")
    if count < recipe.states:
        log.info("%s holds %d states, fewer than pretrain.states=%d: all are used.", source.name, total, recipe.states)
    rng = np.random.default_rng(seed)
    index = np.sort(rng.choice(total, count, replace=False))
    centres = np.intersect1d(index, triple_centres(source.episode), assume_unique=True)
    if len(centres) == 0:
        raise UavrlError(f"Expected three states in a row in {source.name}, no episode is as long: train longer.")
    apart = rng.choice(episodes, min(max(round(recipe.held_out * episodes), 1), episodes - 1), replace=False)
    held_out = np.isin(source.episode[index], apart)
    if held_out.all() or not held_out.any():
        raise UavrlError(
            f"Expected states in and out of {pluralize(len(apart), 'held-out episode')}: raise pretrain.states."
        )
    return StateSample(index, centres, torch.from_numpy(held_out))


def one_shot_sizes(states: Tensor, frames: int = 3) -> Tensor | None:
    """Class sizes of one-shot learning on states ``[N, width]``, or None where the width is not one of whole frames."""
    if states.shape[1] % frames:
        log.info("One-shot learning is left out: states of %d numbers are not %d frames.", states.shape[1], frames)
        return None
    return torch.bincount(OneShotClassifier(states.shape[1] // frames, frames, max_classes=len(states))(states))


def _pretrain(source: States, sample: StateSample, config: PretrainConfig, output: Path) -> dict[str, Any]:
    recipe = config.pretrain
    training: dict[str, Any] = {"seed": config.seed, "progress": config.progress}
    psae, final = train_psae(source.states, sample.centres, recipe, **training)
    states = torch.as_tensor(source.states[sample.index], dtype=torch.float32)
    features = psae.encode(states)
    mean, scale = standardization(features)
    scaled = (features - mean) / scale

    found, sse = _cluster(scaled, config)
    k = recipe.k or sse["elbow"]
    other = recipe.compare_k or k
    classifier = _assemble(psae, mean, scale, found[k], recipe)
    classifier.perception = source.perception
    labels, held_out = found[k].labels, sample.held_out
    train_classifier(scaled[~held_out], labels[~held_out], classifier.classifier, recipe, **training)
    predicted = predict(classifier.classifier, scaled)
    right = (predicted == labels).double()
    one_shot = one_shot_sizes(states) if recipe.one_shot else None
    sizes = {} if one_shot is None else {"one-shot learning": one_shot}
    sizes[f"PSAE and k-means, k = {k}"] = torch.bincount(labels, minlength=k)
    sizes[f"PSAE and classifier, k = {k}"] = torch.bincount(predicted, minlength=k)
    sizes[f"PSAE and k-means, k = {other}"] = torch.bincount(found[other].labels, minlength=other)
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(recipe).items()}
    settings = {"seed": config.seed, "pretrain": values}  # the artifact depends on these, besides its data
    report = {
        "k": k,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": {
            "name": source.name,
            "states": len(source),
            "episodes": len(source.outcomes),
            "outcomes": {outcome: source.outcomes.count(outcome) for outcome in OUTCOMES},
            "sha256": source.sha256(),
            "states_drawn": len(sample.index),
        },
        "config": settings,
        "config_sha256": hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest(),
        "psae": {"triples": len(sample.centres), **final},
        "sse": sse,
        "classifier": {
            "accuracy": right[~held_out].mean().item(),
            "held_out_accuracy": right[held_out].mean().item(),
            "held_out_states": int(held_out.sum()),
        },
        "class_sizes": {name: spread(size) for name, size in sizes.items()},
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("uavrl", "torch", "numpy", "scikit-learn", "kneed", "safetensors")},
        },
    }
    draw(output, sse["k"], sse["sse"], sse["elbow"], sizes)
    return classifier.save(output, report)


def _cluster(scaled: Tensor, config: PretrainConfig) -> tuple[dict[int, Clusters], dict[str, Any]]:
    """The clusters for each k, and the curve of their error with its elbow."""
    recipe = config.pretrain
    options = {"batch_size": recipe.kmeans_batch_size, "iterations": recipe.kmeans_iterations, "seed": config.seed}
    found = cluster_each(scaled, recipe.clusters, progress=config.progress, **options)
    curve = [found[k].sse for k in recipe.clusters]
    at_elbow = elbow(recipe.clusters, curve) if len(recipe.clusters) >= 5 else None
    k = recipe.k or at_elbow
    assert k is not None  # the configuration asks for one of the two
    for missing in {k, recipe.compare_k or k} - set(found):
        found[missing] = cluster(scaled, missing, **options)
    return found, {"k": list(recipe.clusters), "sse": curve, "elbow": at_elbow}


def _assemble(
    psae: PSAE, mean: Tensor, scale: Tensor, clusters: Clusters, recipe: PretrainRecipe
) -> TrajectoryClassifier:
    """The classifier as it will be loaded, its last part untrained."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        classifier = TrajectoryClassifier(
            psae.inputs, recipe.features, recipe.hidden, recipe.classifier_hidden, len(clusters.centres)
        )
    classifier.encoder.load_state_dict(psae.encoder.state_dict())
    for name, value in (("mean", mean), ("scale", scale), ("centres", clusters.centres)):
        getattr(classifier, name).copy_(value)
    return classifier


def spread(size: Tensor) -> dict[str, float]:
    """How evenly states fall into classes, by the classes' sizes ``[k]``; the deviation alone grows with the mean.

    Examples:
        >>> spread(torch.tensor([2, 4, 4, 4, 5, 5, 7, 9]))  # squared distances to 5 are 32, 32 / 8 = 4
        {'classes': 8, 'mean': 5.0, 'largest': 9, 'sd': 2.0}
    """
    sizes = size.double()
    mean, sd = round(sizes.mean().item(), 4), round(sizes.std(correction=0).item(), 4)
    return {"classes": len(size), "mean": mean, "largest": int(size.max()), "sd": sd}
