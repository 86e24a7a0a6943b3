"""An evaluation in shares has each task once, and the result of one that has all of them."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from own_parts.env import Corridor

from tests.helpers.configs import composed
from uavrl.cli.flights import shares_of
from uavrl.config import EvaluateConfig, validate
from uavrl.config.build import TARGET
from uavrl.envs.world import places_of
from uavrl.errors import UavrlError
from uavrl.evaluation.policy_setup import PolicySetup
from uavrl.evaluation.rollout import EpisodeResult
from uavrl.evaluation.shares import Share, divided, merged

TOLD = {"env": "static", "valleys": [100, 101], "planes": 0, "matmul": "mkl", "policy": "straight"}


@pytest.mark.parametrize("processes", [1, 2, 3, 7, 40, 99])
@pytest.mark.parametrize("valleys", [1, 4])
def test_each_task_is_in_one_share_and_all_have_as_many(processes: int, valleys: int) -> None:
    places = np.random.default_rng(0).integers(valleys, size=40).tolist()
    shares = divided(places, processes)
    assert sorted(task for share in shares for task in share) == list(range(40))
    sizes = {len(share) for share in shares}
    assert len(shares) == min(processes, 40) and max(sizes) - min(sizes) <= 1
    assert all(share == sorted(share) for share in shares)
    builders = Counter(place for share in shares for place in {places[task] for task in share})
    assert builders.total() <= valleys + len(shares) - 1, "two shares have at most one valley in common"


def flight(task: int) -> EpisodeResult:
    """One of forty that differ in all that is summed up."""
    rng = np.random.default_rng(task)
    return EpisodeResult(
        task=task,
        outcome=("arrived", "collided", "arrived", "timed_out")[task % 4],
        steps=int(rng.integers(1, 300)),
        world_seed=100 + task % 3,
        straight=float(rng.uniform(10, 20)),
        flown=float(rng.uniform(20, 30)),
        clearance=float(rng.uniform(0, 1)),
        action_change=rng.uniform(0, 1, 4).tolist(),
        yaw_reversals=float(rng.uniform()),
        guard_share=float(rng.uniform()),
        guard_change=float(rng.uniform()),
        spacing=float(rng.uniform(1, 4)),
        detour=float(rng.uniform(1, 2)),
    )


def share(tasks: list[int], **told: Any) -> Share:
    steps = [np.random.default_rng((task, 1)).uniform(0, 5, (3, 7)) for task in tasks]
    return Share([flight(task) for task in tasks], np.concatenate(steps, 1), {**TOLD, **told})


def test_shares_have_the_result_of_one_that_has_all_tasks_to_the_last_digit() -> None:
    facts = {"seed": 7, "env": ""}
    whole = merged([share(list(range(40)), num_uavs=8)], facts)
    parts = divided([task % 3 for task in range(40)], 3)
    found = merged([share(part, num_uavs=min(8, len(part))) for part in parts], facts)
    assert found.pop("processes") == 3 and "processes" not in whole
    assert found == whole
    assert (found["env"], found["seed"], found["num_uavs"]) == ("static", 7, 8)
    assert [each["task"] for each in found["flights"]] == list(range(40))
    assert found["position_stats"]["steps"] == 280 and len(found["success_by_detour"]) == 3


def test_the_vehicles_of_the_largest_share_are_told() -> None:
    found = merged([share([0], num_uavs=1), share([1, 2], num_uavs=2)], {})
    assert (found["num_uavs"], found["processes"]) == (2, 2)


def test_an_environment_without_places_tells_returns() -> None:
    shares = [
        Share([EpisodeResult(task, "arrived", 5, episode_return=task)], None, {"env": "walker"}) for task in (1, 0)
    ]
    found = merged(shares, {})
    assert found["mean_return"] == 0.5 and "position_stats" not in found
    assert [each["episode_return"] for each in found["flights"]] == [0, 1]


# ---------------------------------------------------------------------- of a command


def shares(*overrides: str, env: dict[str, Any] | None = None, evaluations: int = 1) -> list[list[int]]:
    settings = validate(composed("evaluate", "policy=straight", *overrides), EvaluateConfig)
    setup = PolicySetup(None, env or settings.env, settings.perception, settings.reward, {}, {})
    return shares_of(setup, settings, evaluations)


def test_valleys_are_mapped_once_before_processes_share_them(monkeypatch: pytest.MonkeyPatch) -> None:
    mapped: list[list[int]] = []
    monkeypatch.setattr("uavrl.envs.world.map_places", lambda _, numbers: mapped.append(numbers))
    world = ["env.world.seeds=[3,4,5,6]", "episodes=4", "seed=7"]
    assert shares(*world) == [[0, 1, 2, 3]] and not mapped
    settings = validate(composed("evaluate", "policy=straight", *world), EvaluateConfig)
    places = places_of(settings.env.world, 7, range(4))
    assert shares(*world, "processes=2") == divided(places, 2)
    assert mapped == [sorted(set(places))] and len(mapped[0]) < 4


def test_null_takes_as_many_processes_as_there_are_processors_and_tasks_for_their_vehicles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uavrl.envs.world.map_places", lambda *_: None)
    monkeypatch.setattr("uavrl.cli.flights.processors", lambda: 6)
    assert len(shares("episodes=500", "processes=null")) == 6
    assert len(shares("episodes=17", "processes=null")) == 3, "eight vehicles at a time"
    assert len(shares("episodes=500", "processes=null", evaluations=3)) == 2
    assert len(shares("episodes=500", "processes=null", evaluations=9)) == 1
    assert len(shares("episodes=3", "processes=512")) == 3


def test_an_environment_that_cannot_begin_at_any_task_is_not_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavrl.cli.flights.processors", lambda: 6)
    corridor = {TARGET: f"{Corridor.__module__}.Corridor"}
    own = ["packages=[own_parts]", "episodes=100"]
    assert shares(*own, "processes=null", env=corridor) == [list(range(100))]
    with pytest.raises(UavrlError, match="Corridor takes no tasks, so an evaluation in it cannot be divided"):
        shares(*own, "processes=2", env=corridor)
