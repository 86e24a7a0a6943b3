"""Training of the two networks: the autoencoder on triples of states, the classifier on features and labels."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

import numpy as np
import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.losses import PSAELoss
from uavrl.models import PSAE
from uavrl.pretraining.settings import PretrainRecipe
from uavrl.runs.progress_line import ProgressLine


def train_psae(
    states: np.ndarray, centres: np.ndarray, recipe: PretrainRecipe, *, seed: int = 0, progress: bool = False
) -> tuple[PSAE, dict[str, float]]:
    """Trains the autoencoder by Eq. 3.3 on the triples around ``centres`` of ``states [N, width]``.

    Returns:
        The network, and the mean loss, reconstruction error and similarity of the last epoch.
    """
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = PSAE(states.shape[1], recipe.features, recipe.hidden)
    loss = PSAELoss(network, tradeoff=recipe.tradeoff)  # it trains the network's own parameters
    before, anchor, after = (torch.as_tensor(states[centres + i], dtype=torch.float32) for i in (-1, 0, 1))
    triples = TensorDict({"previous": {"observation": before}, "observation": anchor, "next": {"observation": after}})
    triples.auto_batch_size_(1)

    def step(index: Tensor) -> dict[str, Tensor]:
        value, metadata = loss.psae_loss(triples[index])
        return {"loss": value, **metadata}

    final = _train(loss, step, len(triples), recipe, "psae", "autoencoder", seed, progress)
    return network.requires_grad_(False), final


def train_classifier(
    features: Tensor,
    labels: Tensor,
    network: nn.Module,
    recipe: PretrainRecipe,
    *,
    seed: int = 0,
    progress: bool = False,
) -> None:
    """Trains a network in place to give features ``[N, F]`` their labels ``[N]``, by cross-entropy."""

    def step(index: Tensor) -> dict[str, Tensor]:
        return {"loss": F.cross_entropy(network(features[index]), labels[index])}

    _train(network, step, len(features), recipe, "classifier", "classifier", seed, progress)


def _train(
    module: nn.Module,
    step: Callable[[Tensor], dict[str, Tensor]],
    samples: int,
    recipe: PretrainRecipe,
    part: str,
    name: str,
    seed: int,
    progress: bool,
) -> dict[str, float]:
    """Minimises a loss with Adam, whose rate falls to 0 along a cosine; returns the means of the last epoch."""
    lr, epochs, batch_size = (getattr(recipe, f"{part}_{key}") for key in ("lr", "epochs", "batch_size"))
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(module.parameters(), lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    means: dict[str, float] = {}
    with ProgressLine(epochs, f"epochs of the {name}", enabled=progress) as line:
        for _ in range(epochs):
            batches = torch.randperm(samples, generator=generator).split(batch_size)
            sums = torch.zeros(())
            for index in batches:
                values = step(index)
                optimizer.zero_grad()
                values["loss"].backward()
                optimizer.step()
                sums = sums + torch.stack([value.detach() for value in values.values()])
            schedule.step()
            means = dict(zip(values, (sums / len(batches)).tolist(), strict=True))
            if not isfinite(means["loss"]):
                raise UavrlError(f"The {name}'s loss became {means['loss']}: lower pretrain.{part}_lr.")
            line.add(1, f"loss {means['loss']:.4f}")
    return means


@torch.no_grad()
def predict(network: nn.Module, features: Tensor, batch_size: int = 8192) -> Tensor:
    """The label ``[N]`` that the network gives to each feature ``[N, F]``."""
    return torch.cat([network(part).argmax(-1) for part in features.split(batch_size)])
