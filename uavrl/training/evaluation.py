"""Flies fixed, seeded tasks without exploration noise and says how well it went."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from uavrl.training.episodes import RATES, outcome, wilson
from uavrl.training.whereabouts import whereabouts_lines

Policy = Callable[[TensorDictBase], TensorDictBase]


@dataclass(frozen=True)
class Flight:
    """How one task ended; lengths in metres."""

    task: int
    world_seed: int
    outcome: str
    steps: int
    straight: float
    flown: float
    clearance: float

    @property
    def path_efficiency(self) -> float:
        """Straight line from start to end over the length flown, in (0, 1]."""
        return self.straight / max(self.flown, 1e-9)


class FlightRecorder:
    """Follows every vehicle of a batch from reset to done."""

    def __init__(self, count: int) -> None:
        self._start = np.zeros((count, 3))
        self._flown = np.zeros(count)
        self._clearance = np.full(count, np.inf)
        self._steps = np.zeros(count, dtype=int)

    def step(self, before: TensorDictBase, after: TensorDictBase) -> list[Flight]:
        """Takes in one step of all vehicles, ``[N]`` before and after it; returns the flights that it ended."""
        position, next_position = before["position"].double().numpy(), after["position"].double().numpy()
        new = self._steps == 0
        self._start[new] = position[new]
        self._clearance[new] = before["clearance"].numpy()[new, 0]
        self._flown += np.linalg.norm(next_position - position, axis=1)
        self._clearance = np.minimum(self._clearance, after["clearance"].numpy()[:, 0])
        self._steps += 1
        done = after["done"].numpy()[:, 0]
        flights = [self._flight(i, next_position[i], after[i]) for i in np.flatnonzero(done).tolist()]
        self._steps[done] = 0
        self._flown[done] = 0.0
        return flights

    def _flight(self, i: int, end: np.ndarray, last: TensorDictBase) -> Flight:
        return Flight(
            int(last["task"].item()),
            int(last["world_seed"].item()),
            outcome(last),
            int(self._steps[i]),
            float(np.linalg.norm(end - self._start[i])),
            float(self._flown[i]),
            max(float(self._clearance[i]), 0.0),
        )


@torch.no_grad()
def fly(
    env: EnvBase,
    policy: Policy,
    episodes: int,
    *,
    watch: Callable[[np.ndarray], None] | None = None,
    progress: bool = False,
) -> list[Flight]:
    """Flies tasks 0 to ``episodes - 1`` of the environment's seed, each once, to its end.

    Args:
        env: batched navigation environment that emits ``clearance``.
        policy: reads the environment's output, writes ``action``.
        episodes: number of tasks.
        watch: called after each step with the positions ``[M, 3]`` in m of those vehicles whose tasks count.
        progress: show a progress line.

    Returns:
        One flight per task, in the order of the tasks.

    Raises:
        ValueError: when the environment has given out its first tasks already.
    """
    recorder = FlightRecorder(env.batch_size[0])
    flights: dict[int, Flight] = {}
    with (
        set_exploration_type(ExplorationType.DETERMINISTIC),
        tqdm(total=episodes, disable=not progress, unit="ep") as bar,
    ):
        state = env.reset()
        if state["task"].min() != 0:
            raise ValueError("Expected an environment at its first task: call env.set_seed(seed) before flying again.")
        while len(flights) < episodes:
            stepped, state = env.step_and_maybe_reset(policy(state))
            if watch is not None:
                after = stepped["next"]
                watch(after["position"][after["task"][:, 0] < episodes].numpy())
            for flight in recorder.step(stepped, stepped["next"]):
                if flight.task < episodes:
                    flights[flight.task] = flight
                    bar.update()
    return [flights[task] for task in range(episodes)]


def outcome_rates(outcomes: Sequence[str]) -> dict[str, Any]:
    """The number of episodes, and success, collision and time-out rates with Wilson 95 % intervals.

    Raises:
        ValueError: without episodes.
    """
    if not outcomes:
        raise ValueError("Expected at least one flight to summarise, got none.")
    rates = {name: wilson(outcomes.count(ending), len(outcomes)) for name, ending in RATES.items()}
    return {"episodes": len(outcomes), **rates}


def rate_lines(result: dict[str, Any]) -> list[str]:
    """The rates as lines of a table."""
    lines = [f"{'outcome':<12}{'rate':>8}   95 % interval (Wilson), {result['episodes']} episodes"]
    for name in RATES:
        rate = result[name]
        lines.append(f"{name:<12}{rate['rate']:>8.1%}   {rate['low']:.1%} – {rate['high']:.1%}")
    return lines


def summarize_flights(flights: Sequence[Flight]) -> dict[str, Any]:
    """Rates with Wilson 95 % intervals, path efficiency, clearance and steps.

    Path efficiency is the mean over arrivals; the minimum clearance (hull to nearest thing) is given
    as the median over arrivals and as the least of them; both are ``None`` without arrivals.

    Raises:
        ValueError: without flights.

    Examples:
        >>> flights = [Flight(0, 0, "arrived", 100, 18.0, 20.0, 0.4), Flight(1, 0, "collided", 50, 5.0, 6.0, 0.0)]
        >>> result = summarize_flights(flights)
        >>> result["success"]["rate"], result["path_efficiency"], result["steps_per_episode"]
        (0.5, 0.9, 75.0)
    """
    result = outcome_rates([f.outcome for f in flights])
    arrived = [f for f in flights if f.outcome == "arrived"]
    clearances = [f.clearance for f in arrived]
    result["path_efficiency"] = float(np.mean([f.path_efficiency for f in arrived])) if arrived else None
    result["median_clearance"] = float(np.median(clearances)) if arrived else None
    result["min_clearance"] = min(clearances) if arrived else None
    result["steps_per_episode"] = float(np.mean([f.steps for f in flights]))
    result["steps_per_arrival"] = float(np.mean([f.steps for f in arrived])) if arrived else None
    return result


def table(result: dict[str, Any]) -> str:
    """The summary as text for a person."""
    lines = rate_lines(result)
    labels = {
        "path_efficiency": "path efficiency (straight / flown, arrivals)",
        "median_clearance": "minimum clearance, median over arrivals [m]",
        "min_clearance": "minimum clearance, least of all arrivals [m]",
        "steps_per_episode": "steps per episode",
        "steps_per_arrival": "steps per arrival",
    }
    for key, label in labels.items():
        lines.append(f"{label:<46}{'–' if result[key] is None else format(result[key], '.2f'):>8}")
    if "whereabouts" in result:
        lines += whereabouts_lines(result["whereabouts"])
    return "\n".join(lines)
