"""What a resumed run is: bit-identical to one that was never stopped; tests/check tries it with every kind of run."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.helpers.damage import flip_in_the_networks, halve
from tests.helpers.runs import assert_same_run, small_config
from uavrl.errors import UavrlError
from uavrl.runs.checkpoint import RandomState, rotation
from uavrl.runs.config import read_config
from uavrl.training.run import create_run, train
from uavrl.training.trainer import EpisodeTrainer


def test_a_resumed_run_is_bit_identical(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole/run", tmp_path / "cut/run"  # the logger names its folder by the last part
    settings = ["trainer.episodes=8", "logger.interval=1", "buffer=prioritized"]
    config = small_config(whole, *settings)
    train(config, create_run(config))
    shutil.copytree(whole, cut)
    later = rotation(cut).checkpoints()[2:]
    assert later
    for checkpoint in later:
        checkpoint.unlink()
    with (cut / "episodes.csv").open("a") as file:
        file.write("9,9,arri")
    train(small_config(cut, *settings), cut, resume=True)
    assert_same_run(whole, cut)


@pytest.mark.parametrize("harm", [halve, flip_in_the_networks, "lost"], ids=["halved", "flipped", "lost"])
def test_a_run_goes_back_to_the_checkpoint_before_one_that_is_damaged_or_knows_lost_episodes(
    harm: Callable[[Path], None] | str, finished: Path, run_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _, newest = rotation(run_dir).checkpoints()
    if callable(harm):
        harm(newest)
        reason = f"The checkpoint {newest} is damaged"
    else:
        csv = run_dir / "episodes.csv"
        csv.write_text("".join(csv.read_text().splitlines(keepends=True)[:3]))
        reason = f"The checkpoint {newest} follows episode 4, and {csv} has lost those after 2."
    passed_over = newest.read_bytes()
    train(read_config(run_dir), run_dir, resume=True)
    assert reason in caplog.text and "goes back to the one before, after episode 0" in caplog.text
    assert newest.with_name(f"unused-{newest.name}").read_bytes() == passed_over
    assert (run_dir / "episodes.csv").read_bytes() == (finished / "episodes.csv").read_bytes()


@pytest.mark.parametrize("frames", [1, 4])
def test_abr_plus_refuses_states_that_its_artifact_does_not_know(tmp_path: Path, frames: int) -> None:
    config = small_config(tmp_path / "run", "backward_reward=abr_plus", f"perception.frames={frames}")
    with pytest.raises(UavrlError, match=rf"is of perception\.frames=3, and this is {frames}: make one by"):
        train(config, create_run(config))
    assert not (tmp_path / "run/artifact").exists()


def test_a_run_of_another_version_is_told_so_and_left_as_it_is(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (run_dir / "episodes.csv").read_bytes()
    built = EpisodeTrainer.__post_init__

    def knows_more(trainer: EpisodeTrainer) -> None:
        built(trainer)
        trainer.checkpoint.register("newer", RandomState())

    monkeypatch.setattr(EpisodeTrainer, "__post_init__", knows_more)
    with pytest.raises(UavrlError, match="was written by another version of uavrl"):
        train(OmegaConf.merge(read_config(run_dir), {"trainer": {"episodes": 5}}), run_dir, resume=True)
    assert (run_dir / "episodes.csv").read_bytes() == before
