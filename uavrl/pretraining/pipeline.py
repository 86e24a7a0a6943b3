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
from threadpoolctl import threadpool_limits
from torch import Tensor

from uavrl.configs.pretrain import PretrainConfig, PretrainRecipe
from uavrl.errors import UavrlError
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import PSAE, TrajectoryClassifier
from uavrl.pretraining.clustering import (
    Clusters,
    class_sizes,
    cluster,
    cluster_each,
    elbow,
    size_deviation,
    standardization,
)
from uavrl.pretraining.networks import accuracy, predict, train_classifier, train_psae
from uavrl.pretraining.pictures import draw
from uavrl.pretraining.states import States, read_states
from uavrl.pretraining.triples import triple_centres
from uavrl.runs.episodes import OUTCOMES
from uavrl.runs.files import writable
from uavrl.runs.names import PRETRAINED
from uavrl.runs.weights import ARTIFACT

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sample:
    """The states that are learned from.

    Attributes:
        index: ``[n]``, ascending, which of the run's states.
        centres: ``[m]``, those of them that have a neighbour on both sides.
        held_out: ``[n]`` boolean, those of the episodes that the classifier does not learn from.
    """

    index: np.ndarray
    centres: np.ndarray
    held_out: Tensor


def pretrain(config: PretrainConfig) -> dict[str, Any]:
    """Makes the artifact."""
    if config.run is None:
        raise UavrlError("Give run=RUN_FOLDER, of a training whose states are learned from: uavrl-train makes one.")
    torch.set_num_threads(config.threads)
    flown = read_states(Path(config.run))
    sample = draw_sample(flown, config.pretrain, config.seed)
    output = Path(config.output or Path(config.run) / PRETRAINED)
    if any((output / name).exists() for name in (ARTIFACT.json, ARTIFACT.safetensors)):
        raise UavrlError(f"The folder {output} holds an artifact already: choose another with output=FOLDER.")
    writable(output / ARTIFACT.json, "output=FOLDER")
    with threadpool_limits(config.threads):
        about = _pretrain(flown, sample, config, output)
    return {**about, "output": str(output)}


def draw_sample(flown: States, recipe: PretrainRecipe, seed: int) -> Sample:
    """Draws states at random, each as likely as the next, and the episodes that are held out."""
    total, episodes = len(flown), len(flown.outcomes)
    count = min(recipe.states, total)
    if count < recipe.largest_k:
        raise UavrlError(
            f"Expected at least as many states as clusters ({recipe.largest_k}), got {count} of the {total} in "
            f"{flown.name}: fly more, or lower pretrain.clusters, k and compare_k."
        )
    if episodes < 2:
        raise UavrlError(f"Expected 2 or more episodes in {flown.name}, found {episodes}: fly more.")
    if count < recipe.states:
        log.info("%s holds %d states, fewer than pretrain.states=%d: all are used.", flown.name, total, recipe.states)
    rng = np.random.default_rng(seed)
    index = np.sort(rng.choice(total, count, replace=False))
    centres = np.intersect1d(index, triple_centres(flown.episode), assume_unique=True)
    if len(centres) == 0:
        raise UavrlError(f"Expected three states in a row in {flown.name}, no episode is as long: fly more.")
    apart = rng.choice(episodes, min(max(round(recipe.held_out * episodes), 1), episodes - 1), replace=False)
    held_out = np.isin(flown.episode[index], apart)
    if held_out.all() or not held_out.any():
        raise UavrlError(f"Expected states in and out of {len(apart)} held-out episodes: raise pretrain.states.")
    return Sample(index, centres, torch.from_numpy(held_out))


def one_shot_sizes(states: Tensor, frames: int = 3) -> Tensor | None:
    """Class sizes of one-shot learning on states ``[N, width]``, or None where the width is not one of whole frames."""
    if states.shape[1] % frames:
        log.info("One-shot learning is left out: states of %d numbers are not %d frames.", states.shape[1], frames)
        return None
    return class_sizes(OneShotClassifier(states.shape[1] // frames, frames, max_classes=len(states))(states))


def _pretrain(flown: States, sample: Sample, config: PretrainConfig, output: Path) -> dict[str, Any]:
    recipe = config.pretrain
    training: dict[str, Any] = {"seed": config.seed, "progress": config.progress}
    psae, final = train_psae(flown.states, sample.centres, recipe, **training)
    states = torch.as_tensor(flown.states[sample.index], dtype=torch.float32)
    features = psae.encode(states)
    mean, scale = standardization(features)
    scaled = (features - mean) / scale

    options = {"batch_size": recipe.kmeans_batch_size, "iterations": recipe.kmeans_iterations, "seed": config.seed}
    found = cluster_each(scaled, recipe.clusters, progress=config.progress, **options)
    curve = [found[k].sse for k in recipe.clusters]
    at_elbow = elbow(recipe.clusters, curve) if len(recipe.clusters) >= 5 else None
    k = recipe.k or at_elbow
    assert k is not None  # the configuration asks for one of the two
    for other in {k, recipe.compare_k or k} - set(found):
        found[other] = cluster(scaled, other, **options)

    classifier = _assemble(psae, mean, scale, found[k], recipe)
    classifier.perception = flown.perception
    labels, learned_from = found[k].labels, ~sample.held_out
    train_classifier(scaled[learned_from], labels[learned_from], classifier.classifier, recipe, **training)
    sizes = {f"PSAE and k-means, k = {k}": class_sizes(found[k].labels, k)}
    sizes[f"PSAE and classifier, k = {k}"] = class_sizes(predict(classifier.classifier, scaled), k)
    if recipe.compare_k is not None and recipe.compare_k != k:
        sizes[f"PSAE and k-means, k = {recipe.compare_k}"] = class_sizes(
            found[recipe.compare_k].labels, recipe.compare_k
        )
    one_shot = one_shot_sizes(states) if recipe.one_shot else None
    if one_shot is not None:
        sizes = {"one-shot learning": one_shot, **sizes}
    report = {
        "k": k,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": _source(flown, sample),
        "config": _settings(config),
        "config_sha256": hashlib.sha256(json.dumps(_settings(config), sort_keys=True).encode()).hexdigest(),
        "psae": {"triples": len(sample.centres), **final},
        "sse": {"k": list(recipe.clusters), "sse": curve, "elbow": at_elbow},
        "classifier": _accuracies(classifier, scaled, labels, sample.held_out),
        "class_sizes": {name: _spread(size) for name, size in sizes.items()},
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("uavrl", "torch", "numpy", "scikit-learn", "kneed", "safetensors")},
        },
    }
    draw(output, recipe.clusters, curve, at_elbow, sizes)
    return classifier.save(output, report)


def _assemble(
    psae: PSAE, mean: Tensor, scale: Tensor, clusters: Clusters, recipe: PretrainRecipe
) -> TrajectoryClassifier:
    """The classifier as it will be loaded, its last part untrained."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        classifier = TrajectoryClassifier(
            psae.inputs, recipe.features, recipe.hidden, recipe.classifier_hidden, clusters.k
        )
    classifier.encoder.load_state_dict(psae.encoder.state_dict())
    for name, value in (("mean", mean), ("scale", scale), ("centres", clusters.centres)):
        getattr(classifier, name).copy_(value)
    return classifier


def _accuracies(classifier: TrajectoryClassifier, scaled: Tensor, labels: Tensor, held_out: Tensor) -> dict[str, Any]:
    return {
        "accuracy": accuracy(classifier.classifier, scaled[~held_out], labels[~held_out]),
        "held_out_accuracy": accuracy(classifier.classifier, scaled[held_out], labels[held_out]),
        "held_out_states": int(held_out.sum()),
    }


def _source(flown: States, sample: Sample) -> dict[str, Any]:
    return {
        "name": flown.name,
        "states": len(flown),
        "episodes": len(flown.outcomes),
        "outcomes": {outcome: flown.outcomes.count(outcome) for outcome in OUTCOMES},
        "sha256": flown.sha256(),
        "states_drawn": len(sample.index),
    }


def _spread(size: Tensor) -> dict[str, float]:
    """Numbers that tell how evenly states fall into classes; the deviation alone grows with the mean."""
    return {
        "classes": len(size),
        "mean": round(size.double().mean().item(), 4),
        "largest": int(size.max()),
        "sd": round(size_deviation(size), 4),
    }


def _settings(config: PretrainConfig) -> dict[str, Any]:
    """What the artifact depends on, besides its data."""
    recipe = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(config.pretrain).items()}
    return {"seed": config.seed, "pretrain": recipe}
