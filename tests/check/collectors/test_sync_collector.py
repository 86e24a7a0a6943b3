"""Checkpoints, however frequent, leave the outcomes that a training counts as they are."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from tests.helpers.runs import small_config
from uavrl.collectors.sync import SyncCollector
from uavrl.runs.episodes import Episode, read_episodes
from uavrl.training.run import create_run, train

UAVS, SHORT, LONG = 8, 4, 30
LATE = 0.3  # of the flights are long


class Flights(EnvBase):
    """Eight vehicles; flight k after ``set_seed(s)`` takes 4 steps, or 30 in 3 of 10 cases: (s, k) alone decide."""

    def __init__(self) -> None:
        super().__init__(batch_size=[UAVS])
        number = Unbounded((UAVS, 1), dtype=torch.int64)
        self.observation_spec = Composite(task=number, length=number.clone(), shape=(UAVS,))
        self.action_spec = Bounded(-1.0, 1.0, (UAVS, 1))
        self.reward_spec = Unbounded((UAVS, 1))
        flag = Binary(1, (UAVS, 1), dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), shape=(UAVS,))
        self.task, self.length, self.steps = (torch.zeros(UAVS, dtype=torch.int64) for _ in range(3))
        self.set_seed(0)

    def _set_seed(self, seed: int | None) -> None:
        self.seed, self.tasks_begun = seed, 0

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        for uav in range(UAVS) if mask is None else mask.flatten().nonzero().flatten().tolist():
            late = np.random.default_rng((self.seed, self.tasks_begun)).random() < LATE
            self.task[uav], self.length[uav], self.steps[uav] = self.tasks_begun, LONG if late else SHORT, 0
            self.tasks_begun += 1
        return self.emitted(torch.zeros(UAVS, dtype=torch.bool))

    def _step(self, _: TensorDictBase) -> TensorDictBase:
        self.steps += 1
        done = self.steps == self.length
        return self.emitted(done).update({"reward": torch.zeros(UAVS, 1)})

    def emitted(self, done: torch.Tensor) -> TensorDictBase:
        signals = {"task": self.task, "length": self.length, "done": done, "terminated": done}
        return TensorDict({key: value[:, None].clone() for key, value in signals.items()}, [UAVS])


def make_collector() -> SyncCollector:
    policy = TensorDictModule(lambda task: torch.zeros(*task.shape), ["task"], ["action"])
    return SyncCollector(
        Flights(), policy, frames_per_batch=UAVS * 5, total_frames=-1, trajs_per_batch=1, traj_format="cat"
    )


def flown(interval: int, flights: int) -> tuple[list[int], list[list[int]], int]:
    """The lengths of the flights of a training, their numbers between checkpoints, and the steps flown."""
    collector = make_collector()
    collector.restart(1, flights)
    lengths: list[int] = []
    tasks: list[list[int]] = [[]]
    steps = 0
    for flight in collector:  # as the trainer does
        assert len(flight) == flight["length"][0].item()
        lengths.append(len(flight))
        tasks[-1].append(flight["task"][0].item())
        steps += len(flight)
        if len(lengths) == flights:
            break
        if steps >= interval and collector.drain():
            steps = 0
            tasks.append([])
            collector.restart(len(tasks), flights - len(lengths))
    frames = collector.state_dict()["frames"]
    collector.shutdown()
    return lengths, tasks, frames


@pytest.mark.parametrize("interval", [1, 100, 1000])
def test_long_flights_are_as_frequent_among_the_counted_as_among_the_begun(interval: int) -> None:
    lengths, tasks, _ = flown(interval, flights=1500)
    late = lengths.count(LONG) / len(lengths)
    assert abs(late - LATE) < 3 * math.sqrt(LATE * (1 - LATE) / len(lengths)), late
    assert len(tasks) > (1 if interval > 500 else 10)
    for seed, segment in enumerate(tasks, 1):
        assert sorted(segment) == list(range(len(segment))), "of the flights begun, all up to the last are counted"
        assert len(segment) >= UAVS or seed == len(tasks)


def test_with_no_checkpoint_but_the_last_the_first_flights_begun_are_counted_and_not_the_first_ended() -> None:
    lengths, ((*tasks,),), frames = flown(10**9, flights=40)
    assert sorted(tasks) == list(range(40))
    expected = [LONG if np.random.default_rng((1, task)).random() < LATE else SHORT for task in tasks]
    assert lengths == expected
    assert frames >= sum(lengths)


def test_all_flights_count_until_told_otherwise() -> None:
    collector = make_collector()
    tasks = {flight["task"][0].item() for flight, _ in zip(collector, range(3 * UAVS), strict=False)}
    collector.shutdown()
    assert len(tasks) == 3 * UAVS


def segments(episodes: list[Episode]) -> list[list[int]]:
    """The task numbers between barriers, which begin with 0 … N-1 in any order."""
    found: list[list[int]] = [[]]
    for episode in episodes:
        if sorted(found[-1]) == list(range(len(found[-1]))) and episode.task in found[-1]:
            found.append([])
        found[-1].append(episode.task)
    return found


@pytest.mark.parametrize("uavs", [1, 2])
def test_a_training_counts_every_flight_up_to_the_last_before_each_checkpoint(tmp_path: Path, uavs: int) -> None:
    settings = ["trainer.episodes=30", f"env.num_uavs={uavs}", "trainer.updates_per_step=0.01"]
    config = small_config(tmp_path / "run", *settings)
    summary = train(config, create_run(config))
    episodes = read_episodes(tmp_path / "run/episodes.csv")
    assert len(episodes) == config.trainer.episodes
    between = segments(episodes)
    assert len(between) > 2
    for tasks in between:
        assert sorted(tasks) == list(range(len(tasks)))
    assert summary["steps"] == sum(episode.steps for episode in episodes) < summary["steps_flown"]
