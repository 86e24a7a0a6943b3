"""The draw of states, the statistics beside, and the pictures."""

from __future__ import annotations

import builtins
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from uavrl.pretraining import States, pictures, pipeline
from uavrl.pretraining.pipeline import draw_sample, one_shot_sizes
from uavrl.pretraining.settings import PretrainRecipe

RECIPE = PretrainRecipe(states=300, clusters=(2, 3, 4, 5, 6), compare_k=None, held_out=0.2)


def flown(lengths: list[int]) -> States:
    states = np.random.default_rng(0).normal(size=(sum(lengths), 4)).astype(np.float32)
    return States(states, np.repeat(np.arange(len(lengths)), lengths), ["arrived"] * len(lengths), "example")


def test_the_draw_is_of_different_states_whole_triples_and_held_out_episodes() -> None:
    source = flown([20] * 40)
    sample = draw_sample(source, RECIPE, seed=0)
    assert len(sample.index) == 300 == len(np.unique(sample.index))
    assert set(sample.centres) <= set(sample.index)
    for t in sample.centres:
        assert source.episode[t - 1] == source.episode[t] == source.episode[t + 1]
    edges = [t for t in sample.index if t % 20 in (0, 19)]
    assert len(sample.centres) == 300 - len(edges)
    episodes, held_out = source.episode[sample.index], sample.held_out.numpy()
    assert len(set(episodes[held_out])) == 8
    assert not set(episodes[held_out]) & set(episodes[~held_out])


def test_the_draw_follows_the_seed() -> None:
    one, same, other = (draw_sample(flown([20] * 40), RECIPE, seed) for seed in (3, 3, 4))
    assert np.array_equal(one.index, same.index) and torch.equal(one.held_out, same.held_out)
    assert not np.array_equal(one.index, other.index)


def test_two_episodes_are_enough() -> None:
    sample = draw_sample(flown([150, 150]), RECIPE, seed=0)
    assert 0 < int(sample.held_out.sum()) < 300


def test_one_shot_classes_are_counted() -> None:
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(3, 12, generator=generator).repeat_interleave(torch.tensor([5, 2, 1]), 0)
    sizes = one_shot_sizes(states)
    assert sizes is not None and sizes.tolist() == [5, 2, 1]


def test_states_that_are_no_whole_frames_leave_one_shot_learning_out(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.log, "disabled", False)  # Hydra disables the loggers that it finds
    with caplog.at_level(logging.INFO):
        assert one_shot_sizes(torch.zeros(5, 4)) is None
    assert "One-shot learning is left out" in caplog.text


SIZES = {"a": torch.tensor([3, 0, 2]), "b": torch.tensor([4, 1])}


def test_pictures_are_drawn(tmp_path: Path) -> None:
    pictures.draw(tmp_path, [2, 3, 4], [9.0, 2.0, 1.0], 3, SIZES)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["class_sizes.png", "elbow.png"]
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in tmp_path.iterdir())


def test_without_a_curve_there_is_one_picture(tmp_path: Path) -> None:
    pictures.draw(tmp_path, [], [], None, SIZES)
    assert [p.name for p in tmp_path.iterdir()] == ["class_sizes.png"]


def test_without_matplotlib_there_are_none_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name.partition(".")[0] == "matplotlib":
            raise ImportError(name)
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.setattr(pictures.log, "disabled", False)
    with caplog.at_level(logging.INFO):
        pictures.draw(tmp_path, [2, 3], [2.0, 1.0], 2, SIZES)
    assert not list(tmp_path.iterdir())
    assert "pip install 'uavrl[viewer]'" in caplog.text
