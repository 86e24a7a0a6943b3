"""Evaluation flies every task once, without noise, and its numbers are the literal ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from own_parts.env import Corridor
from own_parts.reward import HurryReward
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, exploration_type

from tests.helpers.commands import in_process
from uavrl.cli import evaluate as evaluate_command
from uavrl.evaluation.rollout import EpisodeResult, rollout_episodes
from uavrl.evaluation.suite import suite_table
from uavrl.evaluation.summary import summarize, table
from uavrl.policies.baselines import StraightPolicy
from uavrl.runs.provenance import processor, versions

OUTCOMES = ("arrived", "collided", "timed_out")


class StubEnv(EnvBase):
    """Task ``k`` lasts ``lengths[k]`` steps (later ones 1): three metres along x, then on along y.

    Its outcome is ``OUTCOMES[k % 3]``; ``clearances[k][s]`` is emitted after ``s`` steps.
    """

    def __init__(self, lengths: list[int], vehicles: int, clearances: dict[int, list[float]] | None = None) -> None:
        super().__init__(batch_size=torch.Size([vehicles]))
        self.lengths, self.clearances = lengths, clearances or {}
        self.steps = torch.zeros(vehicles, dtype=torch.int64)
        self.task = torch.zeros(vehicles, dtype=torch.int64)
        self.next_task = 0
        shape = (vehicles, 1)
        flag = Binary(1, shape=shape, dtype=torch.bool)
        count = Unbounded(shape, dtype=torch.int64)
        self.observation_spec = Composite(
            position=Unbounded((vehicles, 3)),
            clearance=Unbounded(shape),
            arrived=flag.clone(),
            collided=flag.clone(),
            task=count.clone(),
            world_seed=count.clone(),
            shape=(vehicles,),
        )
        self.action_spec = Bounded(-2.0, 2.0, shape=(vehicles, 4))
        self.reward_spec = Unbounded(shape)
        self.done_spec = Composite(done=flag.clone(), terminated=flag.clone(), shape=(vehicles,))

    def _length(self, task: int) -> int:
        return self.lengths[task] if task < len(self.lengths) else 1

    def _data(self, ended: torch.Tensor) -> dict[str, torch.Tensor]:
        kind = self.task % 3
        clearance = [
            self.clearances.get(k, [])[s : s + 1] or [9.0]
            for k, s in zip(self.task.tolist(), self.steps.tolist(), strict=True)
        ]
        x, y = self.steps.clamp(max=3), (self.steps - 3).clamp(min=0)
        return {
            "position": torch.stack([x + 10 * self.task, y, 0 * x], -1).float(),
            "clearance": torch.tensor(clearance),
            "arrived": (ended & (kind == 0))[:, None],
            "collided": (ended & (kind == 1))[:, None],
            "task": self.task[:, None].clone(),
            "world_seed": self.task[:, None] + 100,
            "done": ended[:, None],
            "terminated": ended[:, None].clone(),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        mask = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            mask = tensordict["_reset"].reshape(self.batch_size)
        for i in mask.nonzero()[:, 0].tolist():
            self.task[i], self.steps[i] = self.next_task, 0
            self.next_task += 1
        return TensorDict(self._data(torch.zeros(self.batch_size, dtype=torch.bool)), self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.steps += 1
        ended = self.steps >= torch.tensor([self._length(k) for k in self.task.tolist()])
        return TensorDict({**self._data(ended), "reward": torch.zeros(*self.batch_size, 1)}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.next_task = 0


def hover(tensordict: TensorDictBase) -> TensorDictBase:
    return tensordict.set("action", torch.zeros(*tensordict.batch_size, 4))


@pytest.mark.parametrize("lengths", [[1, 1, 1, 1, 1, 1, 1], [40, 2, 1, 3, 2, 1, 5], [1, 2, 1, 3, 2, 1, 30]])
@pytest.mark.parametrize("vehicles", [1, 3, 7])
def test_every_task_is_flown_once_in_order_also_when_some_are_slow(lengths: list[int], vehicles: int) -> None:
    flights = rollout_episodes(StubEnv(lengths, vehicles), hover, len(lengths))
    assert [f.task for f in flights] == list(range(7))
    assert [f.steps for f in flights] == lengths
    assert [f.outcome for f in flights] == [OUTCOMES[k % 3] for k in range(7)]
    assert [f.world_seed for f in flights] == list(range(100, 107))


@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_named_tasks_are_flown_once_and_further_ones_do_not_count(vehicles: int) -> None:
    env, seen = StubEnv([9, 9, 3, 1, 2, 9], vehicles), list[np.ndarray]()
    env.next_task = 2
    flights = rollout_episodes(env, hover, [2, 3, 4], watch=seen.append)
    assert [(flight.task, flight.steps) for flight in flights] == [(2, 3), (3, 1), (4, 2)]
    assert len(np.concatenate(seen)) == 6
    with pytest.raises(ValueError, match="at its first task"):
        rollout_episodes(StubEnv([1, 1, 1], vehicles), hover, [1, 2])


def test_fewer_tasks_than_vehicles() -> None:
    assert [f.task for f in rollout_episodes(StubEnv([5, 1, 1, 1], 4), hover, 2)] == [0, 1]


def test_the_policy_is_asked_for_its_deterministic_action_and_without_gradients() -> None:
    seen: list[Any] = []

    def policy(tensordict: TensorDictBase) -> TensorDictBase:
        seen.append((exploration_type(), torch.is_grad_enabled()))
        return hover(tensordict)

    before = exploration_type()
    rollout_episodes(StubEnv([2, 3], 2), policy, 2)
    assert set(seen) == {(ExplorationType.DETERMINISTIC, False)}
    assert exploration_type() == before


def test_path_and_clearance_on_a_known_path() -> None:
    # Three metres along x, then four along y: 7 m flown, 5 m straight. Task 3 meets its least clearance at its start,
    # and task 0's small one must not leak into it although one vehicle flies both.
    clearances = {0: [3.0, 0.4, 2.0], 3: [0.7, 0.8, 0.9, 1.0], 6: [2.0] * 7 + [-0.1]}
    flights = rollout_episodes(StubEnv([7, 1, 1, 3, 1, 1, 7], 1, clearances), hover, 7)
    assert flights[0].flown == pytest.approx(7.0)
    assert flights[0].straight == pytest.approx(5.0)
    assert flights[0].path_efficiency == pytest.approx(5 / 7)
    assert flights[0].clearance == pytest.approx(0.4)
    assert (flights[3].flown, flights[3].straight) == (3.0, 3.0)
    assert flights[3].path_efficiency == 1.0
    assert flights[3].clearance == pytest.approx(0.7)
    assert flights[6].clearance == 0.0, "a touch is no negative distance"
    ended = {flight.outcome: flight.path_efficiency for flight in flights[:3]}
    assert ended == {"arrived": pytest.approx(5 / 7), "collided": None, "timed_out": None}, "of successes alone"
    assert (flights[2].flown, flights[2].straight) == (1.0, 1.0), "a straight way to nowhere is no efficiency of 1"


@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_the_places_after_every_step_of_the_tasks_that_count_are_watched(vehicles: int) -> None:
    seen: list[np.ndarray] = []
    flights = rollout_episodes(StubEnv([5, 1, 2], vehicles), hover, 3, watch=seen.append)
    assert sum(flight.steps for flight in flights) == 8
    expected = [[1, 0, 0], [2, 0, 0], [3, 0, 0], [3, 1, 0], [3, 2, 0], [11, 0, 0], [21, 0, 0], [22, 0, 0]]
    assert sorted(np.concatenate(seen).tolist()) == expected  # not where tasks 3, 4 … went meanwhile, nor the starts


def flights_of(arrived: int, collided: int, timed_out: int) -> list[EpisodeResult]:
    outcomes = ["arrived"] * arrived + ["collided"] * collided + ["timed_out"] * timed_out
    return [EpisodeResult(k, o, 10, 0, 5.0, 10.0, 0.5) for k, o in enumerate(outcomes)]


@pytest.mark.parametrize(
    ("arrived", "total", "low", "high"),
    [(5, 10, 0.2366, 0.7634), (0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (450, 500, 0.8706, 0.9233)],
)
def test_wilson_interval(arrived: int, total: int, low: float, high: float) -> None:
    result = summarize(flights_of(arrived, total - arrived, 0))["success"]
    assert result["rate"] == arrived / total
    assert (result["low"], result["high"]) == (pytest.approx(low, abs=5e-5), pytest.approx(high, abs=5e-5))


@pytest.mark.parametrize("counts", [(3, 2, 2), (0, 0, 4), (1, 0, 0), (0, 7, 3)])
def test_rates_sum_to_one(counts: tuple[int, int, int]) -> None:
    result = summarize(flights_of(*counts))
    rates = [result[name]["rate"] for name in ("success", "collision", "time_out")]
    assert sum(rates) == pytest.approx(1.0)
    assert rates == [pytest.approx(c / sum(counts)) for c in counts]


def test_summary_takes_path_and_clearance_over_arrivals_alone() -> None:
    flights = [
        EpisodeResult(0, "arrived", 100, 0, 9.0, 10.0, 0.2),
        EpisodeResult(1, "arrived", 60, 0, 5.0, 10.0, 0.6),
        EpisodeResult(2, "arrived", 80, 0, 10.0, 10.0, 1.0),
        EpisodeResult(3, "collided", 20, 0, 1.0, 10.0, 0.0),
        EpisodeResult(4, "timed_out", 300, 0, 0.0, 10.0, 0.1),
    ]
    result = summarize(flights)
    assert result["path_efficiency"] == pytest.approx(0.8)
    assert result["median_clearance"] == pytest.approx(0.6)
    assert result["min_clearance"] == pytest.approx(0.2)
    assert result["steps_per_arrival"] == 80.0
    assert result["outcomes"] == "SSSCT"
    assert result["steps_per_episode"] == 112.0


def test_the_actions_of_each_task_are_measured_alone_and_within_their_limits() -> None:
    """One vehicle flies three tasks of 4, 1 and 3 steps; the first asks for more than 2 m/s can give."""
    rows = [[0.0, 0.5, 0.0, 1.0], [1.0, 0.5, 0.0, -1.0], [9.0, 0.5, 0.3, -1.0], [2.0, 0.5, 0.0, 1.0]]  # task 0
    rows += [[-2.0, 0.0, 0.0, -1.0]]  # task 1
    rows += [[1.0, 0.0, 0.0, 0.06], [1.0, 0.0, 0.0, -0.04], [1.0, 0.0, 0.0, -0.06]]  # task 2
    asked = iter(rows)
    flights = rollout_episodes(StubEnv([4, 1, 3], 1), lambda state: state.set("action", torch.tensor([next(asked)])), 3)
    assert flights[0].action_change == pytest.approx([2 / 3, 0.0, 0.2, 4 / 3])
    assert flights[0].yaw_reversals == pytest.approx(2 / 3)
    assert flights[1].action_change is flights[1].yaw_reversals is None, "one step changes nothing"
    assert flights[2].action_change == pytest.approx([0.0, 0.0, 0.0, 0.06]) and flights[2].yaw_reversals == 0.0
    result = summarize(flights)
    assert result["action_change"] == pytest.approx([0.4, 0.0, 0.12, 0.824])  # of five changes
    assert result["yaw_reversals"] == pytest.approx(0.4)


class SlowedEnv(StubEnv):
    """A guard lets its vehicles fly forward at no more than 1 m/s."""

    def __init__(self, lengths: list[int]) -> None:
        super().__init__(lengths, 1)
        self.observation_spec["flown_action"] = Unbounded((1, 4))

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        return super()._reset(tensordict, **kwargs).set("flown_action", torch.zeros(1, 4))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        flown = tensordict["action"].clone()
        flown[:, 0] = flown[:, 0].clamp(max=1.0)
        return super()._step(tensordict).set("flown_action", flown)


@pytest.mark.parametrize(("limit", "change"), [(4.0, 3.0), (2.0, 2.0)])
def test_actions_are_within_the_limit_of_the_environment(limit: float, change: float) -> None:
    env = StubEnv([2], 1)
    env.max_speed = limit
    asked = iter([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 3.0]])
    (flight,) = rollout_episodes(env, lambda state: state.set("action", torch.tensor([next(asked)])), 1)
    assert flight.action_change == [change, 0.0, 0.0, 2.0], "the yaw rate has a limit of its own"


def test_how_often_guards_change_the_velocity_and_by_how_much() -> None:
    """What is asked for beyond 2 m/s, and 0.04 m/s, are no changes by a guard."""
    asked = iter([[9.0, 0.0, 0.0, 0.0], [1.04, 0.0, 0.0, 0.0], [1.5, 0.0, 0.0, 1.0], [0.5, 0.0, 0.0, 0.0]])
    flights = rollout_episodes(SlowedEnv([3, 1]), lambda state: state.set("action", torch.tensor([next(asked)])), 2)
    assert flights[0].guard_share == pytest.approx(2 / 3) and flights[0].guard_change == pytest.approx(0.75)
    assert flights[0].action_change == pytest.approx([0.0, 0.0, 0.0, 0.5]), "of what was flown"
    assert (flights[1].guard_share, flights[1].guard_change) == (0.0, None)
    result = summarize(flights)
    assert result["guard_share"] == pytest.approx(0.5) and result["guard_change"] == pytest.approx(0.75)
    assert "steps in which guards change the velocity       50.0 %, by 0.75 m/s on average" in table(result)
    assert suite_table({"static": result}).split()[-2] == "50.0"
    unguarded = summarize(flights_of(1, 0, 0))
    assert "guard_share" not in unguarded and "guards" not in table(unguarded)


def test_tables_tell_how_smooth_it_was_and_nothing_where_that_is_not_known() -> None:
    flights = [
        EpisodeResult(0, "arrived", 11, 0, 5.0, 10.0, 0.5, action_change=[0.21, 0.05, 0.02, 0.4], yaw_reversals=0.1)
    ]
    known, older = summarize(flights), summarize(flights_of(1, 0, 0))
    assert table(known).splitlines()[-3:] == [
        "mean change of the action per step              "
        "0.21 / 0.05 / 0.02 m/s (forward / left / up), 0.40 rad/s (yaw rate)",
        "steps that reverse the yaw rate                 10.0 %",
        "Success rate: 100.0 % (95 % CI 20.7–100.0 %, 1 task)",
    ]
    assert not {"action_change", "yaw_reversals"} & older.keys() and "yaw rate" not in table(older)
    head, first, second = suite_table({"static": known, "dense": older}).splitlines()
    assert first.split() == ["static", "100.0", "(20.7–100.0)", "0.0", "0.0", "11", "0.50", "0.40", "10.0", "–", "–"]
    assert second.split()[-4:] == ["–"] * 4
    assert "success, % (95 % CI)" in head and len(head) == len(first) == len(second)


def test_success_is_told_in_parts_of_the_tasks_by_their_difficulty() -> None:
    hard = [
        replace(
            EpisodeResult(k, "collided" if k > 7 else "arrived", 9, 0, 5.0, 6.0, 0.5), detour=1 + k / 10, spacing=2.0
        )
        for k in range(12)
    ]
    result = summarize(hard[::-1])
    assert [each["rate"] for each in result["success_by_detour"]] == [1.0, 1.0, 0.0]
    assert [(each["least"], each["most"]) for each in result["success_by_detour"]][2] == (1.8, 2.1)
    assert "success, detour 1.80 to 2.10" in table(result)
    assert "success_by_spacing" not in result and "free width" not in table(result), "all are alike"
    assert suite_table({"static": result}).splitlines()[1].split()[-5:] == ["100", "/", "100", "/", "0"]
    assert "success_by_detour" not in summarize(hard[:8]), "too few"


@pytest.mark.parametrize(
    ("detours", "told"),
    [
        ([1.0] * 8 + [1.2, 1.4, 1.6, 1.8], {"1.00": 8, "1.20 to 1.40": 2, "1.60 to 1.80": 2}),
        ([1.001, 1.002, 1.004] * 3 + [1.5] * 3, {"1.00": 9, "1.50": 3}),
        ([1.1, 1.2] + [1.3] * 10, {"1.10 to 1.20": 2, "1.30": 10}),
    ],
)
def test_tasks_of_equal_difficulty_are_in_one_part(detours: list[float], told: dict[str, int]) -> None:
    flights = [replace(EpisodeResult(k, "arrived", 9, 0, 5.0, 6.0, 0.5), detour=each) for k, each in enumerate(detours)]
    lines = [line for line in table(summarize(flights)).splitlines() if line.startswith("success, detour")]
    assert [line.split("  ")[0].removeprefix("success, detour ") for line in lines] == list(told)
    assert [int(line.split(", ")[-1].split()[0]) for line in lines] == list(told.values())


def test_without_arrivals_there_is_no_path_and_the_table_says_so() -> None:
    result = summarize(flights_of(0, 1, 1))
    assert result["path_efficiency"] is result["median_clearance"] is result["min_clearance"] is None
    assert sum(line.rstrip().endswith("–") for line in table(result).splitlines()) == 4


def test_flights_in_several_valleys_are_also_counted_valley_by_valley() -> None:
    ends = {7: "aaac" * 3, 9: "accc", 10: "aacc"}
    flights = [
        EpisodeResult(0, {"a": "arrived", "c": "collided"}[end], 10, v, 5.0, 10.0, 0.5) for v in ends for end in ends[v]
    ]
    result = summarize(flights)
    rates = {valley: found["rate"] for valley, found in result["success_by_valley"].items()}
    assert rates == {"7": 0.75, "9": 0.25, "10": 0.5}
    assert "success_by_valley" not in summarize(flights[:12])


def test_only_valleys_with_ten_tasks_have_a_line_of_their_own() -> None:
    ends = {7: "aaac" * 3, 8: "aaaacccccc", 9: "accc", 10: "aacc"}
    flights = [
        EpisodeResult(0, {"a": "arrived", "c": "collided"}[end], 10, v, 5.0, 10.0, 0.5) for v in ends for end in ends[v]
    ]
    assert [line for line in table(summarize(flights)).splitlines() if "valley" in line] == [
        "success in valley 7                             75.0 % (95 % CI 46.8–91.1 %, 12 tasks)",
        "success in valley 8                             40.0 % (95 % CI 16.8–68.7 %, 10 tasks)",
        "valleys with fewer than ten tasks               2, whose rates are in the file",
    ]
    assert "ten tasks" not in table(summarize(flights[:22]))


def test_no_flights_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one episode"):
        summarize([])


def test_a_slow_straight_policy_turns_as_its_environment_allows() -> None:
    state = TensorDict({"heading_deg": torch.tensor([[90.0]]), "altitude": torch.tensor([[0.0]])}, [1])
    assert StraightPolicy(max_speed=1.0)(state)["action"].tolist() == [[0.0, 0.0, 1.0, 1.0]]
    assert StraightPolicy(max_speed=6.0)(state)["action"].tolist() == [[0.0, 0.0, 3.5, 2.0]]


@pytest.mark.parametrize(
    ("heading", "altitude", "action"),
    [
        (0.0, 3.5, [2.0, 0.0, 0.0, 0.0]),
        (90.0, 3.5, [0.0, 0.0, 0.0, 2.0]),
        (270.0, 3.5, [0.0, 0.0, 0.0, -2.0]),
        (5.0, 3.0, [2.0, 0.0, 0.5, 0.2617994]),  # 3 · 5° = 0.2618 rad/s; half a metre too low
        (350.0, 9.0, [0.0, 0.0, -2.0, -0.5235988]),  # -10° lies outside the cone of 0.15 rad = 8.6°
        (180.0, 0.0, [0.0, 0.0, 2.0, -2.0]),
    ],
)
def test_straight_policy(heading: float, altitude: float, action: list[float]) -> None:
    state = TensorDict({"heading_deg": torch.tensor([[heading]]), "altitude": torch.tensor([[altitude]])}, [1])
    torch.testing.assert_close(StraightPolicy()(state)["action"], torch.tensor([action]), atol=1e-5, rtol=0)


def test_the_valleys_asked_for_are_flown_and_two_evaluations_agree(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    results = []
    for name in ("one", "other"):
        arguments = ["policy=straight", "episodes=6", "num_uavs=2", "env.max_steps=4", "progress=false"]
        output = tmp_path / f"{name}.json"
        assert in_process(evaluate_command.main, *arguments, "valleys=[7,9]", f"output={output}") == 0
        results.append(json.loads(output.read_text()))
    assert results[0] == results[1]
    assert results[0]["valleys"] == [7, 9]
    assert {f["world_seed"] for f in results[0]["flights"]} == {7, 9}
    assert list(results[0]["success_by_valley"]) == ["7", "9"]
    assert [f["task"] for f in results[0]["flights"]] == list(range(6))
    assert all(1 <= f["steps"] <= 4 for f in results[0]["flights"])
    letters = {"arrived": "S", "collided": "C", "timed_out": "T"}
    assert results[0]["outcomes"] == "".join(letters[f["outcome"]] for f in results[0]["flights"])
    assert results[0]["versions"] == versions() and results[0]["processor"] == processor()
    assert [len(f["action_change"]) for f in results[0]["flights"]] == [4] * 6 == [len(results[0]["action_change"])] * 6
    assert all(0 <= f["yaw_reversals"] <= 1 for f in results[0]["flights"])
    went = results[0]["position_stats"]
    assert went["steps"] == sum(f["steps"] for f in results[0]["flights"])
    assert 3.3 < went["altitude"]["p5"] <= went["altitude"]["p95"] < 3.7, "it starts at 3.5 m and keeps that height"
    told = capfd.readouterr().out
    assert " m (5th / 50th / 95th percentile)\n" in told
    assert told.count("Success rate: 0.0 % (95 % CI 0.0–39.0 %, 6 tasks)") == 2 and "Solved" not in told


def test_an_environment_of_one_without_places_tells_its_returns() -> None:
    env = TransformedEnv(Corridor(max_steps=30), HurryReward())
    asked = iter([[0.05, 0.02], [-0.05, 0.0]] * 45)
    flights = rollout_episodes(env, lambda state: state.set("action", torch.tensor(next(asked))), 3)
    assert [flight.task for flight in flights] == [0, 1, 2]
    assert {flight.steps for flight in flights} == {30} and {flight.outcome for flight in flights} == {"timed_out"}
    assert [flight.episode_return for flight in flights] == pytest.approx([-3.0] * 3)
    result = summarize(flights)
    assert result["median_return"] == pytest.approx(-3.0)
    assert "path_efficiency" not in result and "mean return" in table(result)
    assert result["action_change"] == pytest.approx([0.1, 0.02]) and "yaw_reversals" not in result
    assert table(result).splitlines()[-2] == "mean change of the action per step              0.10 / 0.02"
