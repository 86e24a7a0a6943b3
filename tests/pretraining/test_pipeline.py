"""The draw of states, and the classes of one-shot learning."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import torch

from uavrl.pretraining import States, pipeline
from uavrl.pretraining.pipeline import draw_sample, one_shot_sizes
from uavrl.pretraining.settings import PretrainRecipe

RECIPE = PretrainRecipe(states=300, clusters=(2, 3, 4, 5, 6), compare_k=None, held_out=0.2)


def source(lengths: list[int]) -> States:
    states = np.random.default_rng(0).normal(size=(sum(lengths), 4)).astype(np.float32)
    return States(states, np.repeat(np.arange(len(lengths)), lengths), ["arrived"] * len(lengths), "example")


def test_the_draw_is_of_different_states_whole_triples_and_held_out_episodes() -> None:
    states = source([20] * 40)
    sample = draw_sample(states, RECIPE, seed=0)
    assert len(sample.index) == 300 == len(np.unique(sample.index))
    assert set(sample.centres) <= set(sample.index)
    for t in sample.centres:
        assert states.episode[t - 1] == states.episode[t] == states.episode[t + 1]
    edges = [t for t in sample.index if t % 20 in (0, 19)]
    assert len(sample.centres) == 300 - len(edges)
    episodes, held_out = states.episode[sample.index], sample.held_out.numpy()
    assert len(set(episodes[held_out])) == 8
    assert not set(episodes[held_out]) & set(episodes[~held_out])


def test_the_draw_follows_the_seed() -> None:
    one, same, other = (draw_sample(source([20] * 40), RECIPE, seed) for seed in (3, 3, 4))
    assert np.array_equal(one.index, same.index) and torch.equal(one.held_out, same.held_out)
    assert not np.array_equal(one.index, other.index)
    two_episodes = draw_sample(source([150, 150]), RECIPE, seed=0)
    assert 0 < int(two_episodes.held_out.sum()) < 300


def test_one_shot_classes_are_counted_of_whole_frames(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(3, 12, generator=generator).repeat_interleave(torch.tensor([5, 2, 1]), 0)
    sizes = one_shot_sizes(states)
    assert sizes is not None and sizes.tolist() == [5, 2, 1]
    monkeypatch.setattr(pipeline.log, "disabled", False)  # Hydra disables the loggers that it finds
    with caplog.at_level(logging.INFO):
        assert one_shot_sizes(torch.zeros(5, 4)) is None
    assert "One-shot learning is left out" in caplog.text
