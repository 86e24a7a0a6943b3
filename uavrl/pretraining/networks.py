"""Training of the two networks: the autoencoder on triples of states, the classifier on features and labels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torch import Tensor, nn
from tqdm import tqdm

from uavrl.errors import UavrlError
from uavrl.losses.psae import PSAELoss
from uavrl.models.psae import PSAE
from uavrl.pretraining.settings import PretrainRecipe

T = TypeVar("T")


def progress_bar(values: Iterable[T], description: str, show: bool) -> tqdm[T]:
    """A progress bar on standard error."""
    return tqdm(values, desc=description, disable=not show, dynamic_ncols=True)


def train_psae(
    states: np.ndarray,
    centres: np.ndarray,
    recipe: PretrainRecipe,
    *,
    seed: int = 0,
    progress: bool = False,
) -> tuple[PSAE, dict[str, float]]:
    """Trains the autoencoder by Eq. 3.3 with Adam; the learning rate falls to 0 along a cosine."""
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = PSAE(states.shape[1], recipe.features, recipe.hidden)
    loss_module = PSAELoss(network, tradeoff=recipe.tradeoff)
    before, anchor, after = (torch.as_tensor(states[centres + i], dtype=torch.float32) for i in (-1, 0, 1))
    triples = TensorDict({"previous": {"observation": before}, "observation": anchor, "next": {"observation": after}})
    triples.auto_batch_size_(1)
    optimizer = torch.optim.Adam(loss_module.parameters(), recipe.psae_lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, recipe.psae_epochs)
    final: dict[str, float] = {}
    bar = progress_bar(range(recipe.psae_epochs), "autoencoder, epochs", progress)
    for _ in bar:
        sums, batches = torch.zeros(3), 0
        for index in _batches(len(triples), recipe.psae_batch_size, generator):
            loss, metadata = loss_module.psae_loss(triples[index])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            sums += torch.stack([loss.detach(), metadata["reconstruction_error"], metadata["similarity"]])
            batches += 1
        schedule.step()
        final = dict(zip(("loss", "reconstruction_error", "similarity"), (sums / batches).tolist(), strict=True))
        if not np.isfinite(final["loss"]):
            raise UavrlError(f"The autoencoder's loss became {final['loss']}: lower pretrain.psae_lr.")
        bar.set_postfix_str(f"loss {final['loss']:.4f}")
    return network.requires_grad_(False), final  # the loss module trains the network's own parameters


def train_classifier(
    features: Tensor,
    labels: Tensor,
    network: nn.Module,
    recipe: PretrainRecipe,
    *,
    seed: int = 0,
    progress: bool = False,
) -> None:
    """Trains a network in place to say the label of a feature, by cross-entropy with Adam."""
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(network.parameters(), recipe.classifier_lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, recipe.classifier_epochs)
    bar = progress_bar(range(recipe.classifier_epochs), "classifier, epochs", progress)
    for _ in bar:
        total = torch.zeros(())
        for index in _batches(len(features), recipe.classifier_batch_size, generator):
            loss = F.cross_entropy(network(features[index]), labels[index])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.detach() * len(index)
        schedule.step()
        mean = total.item() / len(features)
        if not np.isfinite(mean):
            raise UavrlError(f"The classifier's loss became {mean}: lower pretrain.classifier_lr.")
        bar.set_postfix_str(f"loss {mean:.4f}")


@torch.no_grad()
def predict(network: nn.Module, features: Tensor, batch_size: int = 8192) -> Tensor:
    """The label ``[N]`` that the network gives to each feature ``[N, F]``."""
    return torch.cat([network(part).argmax(-1) for part in features.split(batch_size)])


def accuracy(network: nn.Module, features: Tensor, labels: Tensor) -> float:
    """The share of features ``[N, F]`` to which the network gives their label ``[N]``."""
    return (predict(network, features) == labels).double().mean().item()


def _batches(total: int, size: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Indices of all samples in random order, ``size`` at a time."""
    yield from torch.randperm(total, generator=generator).split(size)
