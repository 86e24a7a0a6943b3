"""Which collectors a run takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tensordict import TensorDictBase
from torchrl.collectors import Collector

from tests.helpers.configs import composed
from tests.helpers.runs import small_config
from uavrl.config import validate
from uavrl.errors import FlyingEnded, UavrlError
from uavrl.runs.checkpoint import all_checkpoints
from uavrl.runs.config import free_keys
from uavrl.runs.episodes import read_episodes
from uavrl.training.build import collector_class
from uavrl.training.run import create_run, resume_config, train


class Plain(Collector):
    """One of TorchRL's as it is."""


class Mine(Collector):
    """One of TorchRL's with what a run asks for, an option of its own, and a fault: it dies after some flights."""

    is_remote = False

    def __init__(self, *args: Any, dies_after: int | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.dies_after = dies_after
        self.flown = 0

    def __iter__(self) -> Iterator[TensorDictBase]:
        for flight in super().__iter__():
            if self.flown == self.dies_after:
                raise FlyingEnded("the wind blew it away")
            self.flown += 1
            yield flight

    def restart(self, seed: int, episodes: int) -> None:
        self.set_seed(seed, static_seed=True)
        self.reset()

    def drain(self) -> bool:
        return True


def chosen(name: str) -> type:
    config = composed()
    config.collector._target_ = f"{__name__}.{name}"
    config.packages = ["tests"]
    return collector_class(validate(config))


def test_one_that_has_what_a_run_asks_for_is_taken_and_another_is_told_what_it_lacks() -> None:
    assert chosen("Mine") is Mine
    with pytest.raises(UavrlError, match="Plain lacks is_remote, restart, drain: subclass one of them"):
        chosen("Plain")


def test_one_of_your_own_flies_a_run_and_what_was_learned_is_kept_when_it_dies(tmp_path: Path) -> None:
    config = small_config(
        tmp_path / "run",
        f"collector._target_={__name__}.Mine",
        "+collector.dies_after=7",
        "packages=[tests]",
        "trainer.episodes=10",
        "trainer.checkpoint_interval=100000",  # so that none is due before
    )
    run_dir = create_run(config)
    told = rf"\(the wind blew it away\); .* after episode 7, which is saved: resume with uavrl-train resume={run_dir}"
    with pytest.raises(FlyingEnded, match=told):
        train(config, run_dir)
    episodes = read_episodes(run_dir / "episodes.csv")
    assert len(episodes) == 7
    assert all_checkpoints(run_dir)[-1].name.endswith(f"{episodes[-1].total_steps:012d}.torchrl")
    resumed = resume_config(run_dir, config, [])
    assert train(resumed, run_dir, resume=True)["episodes"] == 10  # a new one, which flies three more
    assert [episode.episode for episode in read_episodes(run_dir / "episodes.csv")] == list(range(1, 11))


def test_what_the_run_sets_itself_is_refused(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "+collector.total_frames=5")
    with pytest.raises(UavrlError, match=r"collector.total_frames is set by the run itself: leave it out"):
        train(config, create_run(config))


def test_the_address_of_a_cluster_is_not_taken_from_a_run_folder(tmp_path: Path) -> None:
    run_dir = create_run(small_config(tmp_path / "run", "collector=ray", "collector.address=10.0.0.1:6379"))
    told = "was trained on the Ray cluster 10.0.0.1:6379, and .*: add collector=ray collector.address=10.0.0.1:6379"
    with pytest.raises(UavrlError, match=told):
        resume_config(run_dir, composed(), [])
    for address in ("auto", None):
        given = composed("config", "collector=ray", f"collector.address={address or 'null'}", "collector.workers=1")
        changed = ["collector", "collector.address", "collector.workers"]  # as the command line has them
        collector = resume_config(run_dir, given, changed).collector
        assert (collector.address, collector.workers) == (address, 1)


@pytest.mark.parametrize("collector", ["sync", "async", "ray"])
def test_a_sweep_goes_on_with_a_run_of_any_collector(collector: str, tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", f"collector={collector}")
    config.trainer.episodes = 7
    run_dir = create_run(config)
    resumed = resume_config(run_dir, config, free_keys(config))
    assert validate(resumed).trainer.episodes == 7
    assert resumed.collector == config.collector
