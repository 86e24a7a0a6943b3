"""Training of the autoencoder and the classifier."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.helpers.states import walk
from uavrl.errors import UavrlError
from uavrl.models import PSAE, mlp
from uavrl.pretraining import triple_centres
from uavrl.pretraining.networks import predict, train_classifier, train_psae
from uavrl.pretraining.settings import PretrainRecipe


def states() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    episodes = [walk(12, 6, rng) for _ in range(20)]
    return np.concatenate(episodes), np.repeat(np.arange(20), 12)


def trained(epochs: int, seed: int = 0, **kwargs: float) -> tuple[PSAE, dict[str, float]]:
    values, episode = states()
    options = {"features": 4, "hidden": 16, "psae_batch_size": 32, "psae_lr": 1e-2, **kwargs}
    recipe = PretrainRecipe(psae_epochs=epochs, **options)  # type: ignore[arg-type]
    return train_psae(values, triple_centres(episode), recipe, seed=seed)


def test_the_autoencoder_learns_to_reconstruct_and_to_bring_neighbours_together() -> None:
    start, end = trained(1)[1], trained(30)[1]
    assert end["reconstruction_error"] < 0.2 * start["reconstruction_error"]
    assert end["similarity"] > 1.9
    assert end["loss"] == pytest.approx(0.7 * end["reconstruction_error"] - 0.3 * end["similarity"], abs=1e-5)


def test_similarity_is_earned_where_it_is_paid() -> None:
    assert trained(10, tradeoff=0.0)[1]["similarity"] > trained(10, tradeoff=1.0)[1]["similarity"]


def test_the_same_seed_gives_the_same_network_and_leaves_the_global_generator_alone() -> None:
    before = torch.random.get_rng_state()
    one, same, other = (trained(2, seed)[0].encoder[0].weight for seed in (0, 0, 1))
    assert torch.equal(one, same) and not torch.equal(one, other)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert not one.requires_grad


def test_a_loss_that_is_no_number_ends_the_training() -> None:
    with pytest.raises(UavrlError, match=r"loss became .*: lower pretrain\.psae_lr"):
        trained(30, psae_lr=1e30)


def test_the_classifier_learns_nearest_centres() -> None:
    generator = torch.Generator().manual_seed(0)
    centres = torch.randn(8, 3, generator=generator)
    features = torch.randn(2000, 3, generator=generator)
    labels = torch.cdist(features, centres).argmin(-1)
    torch.manual_seed(0)
    network = mlp(3, [64], 8)
    train_classifier(
        features[:1800], labels[:1800], network, PretrainRecipe(classifier_epochs=30, classifier_batch_size=64)
    )
    right = predict(network, features[1800:], batch_size=64) == labels[1800:]
    assert right.double().mean() > 0.9
