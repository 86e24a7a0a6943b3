"""Does a policy dither where the goal lies exactly behind, where the folded heading jumps from +1 to -1?

    python studies/goal_behind.py policy=best 'valleys=[100,101,102,103,104,105,106,107,108,109]'
    python studies/goal_behind.py policy=vfh perception=range_image
    python studies/goal_behind.py policy=best --angle 0          # the same tasks, facing the goal

The tasks of an evaluation, each turned so that its goal lies at 180 degrees, give or take one. Of the first 20 steps it
tells how often the yaw rate reverses (uavrl.evaluation.smoothness), how often it does so while the goal lies more
than 90
degrees off the head, to which side the commanded yaw rates turn in sum, and the angle to the goal after them; then how
many starts are solved. Arguments are those of uavrl-evaluate.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torchrl.envs import EnvBase

from uavrl.config import EvaluateConfig, compose, validate
from uavrl.envs import NavigationEnv
from uavrl.evaluation.environment import make_device, make_env
from uavrl.evaluation.policies import choose, policy_folder
from uavrl.evaluation.rollout import Policy, rollout
from uavrl.evaluation.smoothness import YAW_RATE, yaw_reversals
from uavrl.runs.episodes import outcome, wilson
from uavrl_onboard.cli.process import one_sentence


class GoalAtAngle(NavigationEnv):
    """The valley, whose tasks begin with the goal at an angle to the head.

    Args:
        goal_at: that angle in degrees, left positive.
        within: the most that a task is off it, drawn evenly from the seed and the task's number.
    """

    def __init__(self, num_uavs: int = 8, *, goal_at: float = 180.0, within: float = 1.0, **valley: Any) -> None:
        self.goal_at, self.within = goal_at, within
        super().__init__(num_uavs, **valley)

    def _place(self, index: np.ndarray) -> None:
        super()._place(index)
        starts = self.simulation.position[index]
        drawn = [np.random.default_rng((self._seed, task, 1)).uniform(-1, 1) for task in self._task[index]]
        forward, left = (self._goal[index] - starts)[:, :2].T
        yaws = np.arctan2(left, forward) - np.radians(self.goal_at + self.within * np.array(drawn))
        self.simulation.reset(index, starts, yaws)


class Start(NamedTuple):
    """One task's first steps, and its end."""

    reversals: int  # of the yaw rate
    behind: int  # of them, those with the goal more than 90 degrees off the head
    turned: float  # the sum of the yaw rates times their duration, rad, left positive
    angle: float  # between head and goal afterwards, degrees
    outcome: str


@torch.no_grad()
def first_steps(env: EnvBase, policy: Policy, starts: int, steps: int) -> list[Start]:
    """Rolls out tasks 0 to ``starts - 1`` to their ends, and measures their first steps."""
    rates: defaultdict[int, list[float]] = defaultdict(list)
    angles: defaultdict[int, list[float]] = defaultdict(list)  # before each of the steps, and after the last
    ends: dict[int, str] = {}
    for stepped in rollout(env, policy, env.reset()):
        after = stepped["next"]
        for i, task in enumerate(after["task"][:, 0].tolist()):
            if len(rates[task]) < steps:
                rates[task].append(stepped["action"][i, YAW_RATE].clamp(-2, 2).item())
                angles[task] = [*angles[task][:-1], *(off_head(each["heading_deg"][i]) for each in (stepped, after))]
            if after["done"][i]:
                ends[task] = outcome(after[i])
        if all(task in ends for task in range(starts)):
            break
    return [measured(rates[task], angles[task], ends[task]) for task in range(starts)]


def off_head(heading: torch.Tensor) -> float:
    """The size of an angle of 0 to 360 degrees, at most 180."""
    return abs((heading.item() + 180) % 360 - 180)


def measured(rates: list[float], angles: list[float], end: str) -> Start:
    """What is told of one start.

    Args:
        rates: the yaw rates of T steps in rad/s, a tenth of a second each.
        angles: between head and goal before each of them and after the last, T + 1, degrees.
        end: how the episode ended.
    """
    pairs = np.zeros((len(rates) - 1, 2, 4))
    pairs[:, 0, YAW_RATE], pairs[:, 1, YAW_RATE] = rates[:-1], rates[1:]
    reversed_by = np.array([yaw_reversals(pair) for pair in pairs], dtype=bool)
    behind = reversed_by & (np.array(angles[1:-1]) > 90)
    return Start(int(reversed_by.sum()), int(behind.sum()), 0.1 * sum(rates), angles[-1], end)


def main() -> None:
    """Prints one line a question."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--angle", type=float, default=180.0, help="at which the goal lies, degrees, left positive")
    parser.add_argument("--within", type=float, default=1.0, help="degrees")
    parser.add_argument("--json", type=Path)
    args, overrides = parser.parse_known_args()
    torch.set_num_threads(1)
    config = compose(*overrides, name="evaluate")
    settings = validate(config, EvaluateConfig)
    folder = policy_folder(settings.run, settings.policy)
    chosen = choose(settings, config, overrides, folder, make_device(settings.device))
    turned = {"_target_": "goal_behind.GoalAtAngle", "goal_at": args.angle, "within": args.within}
    packages = (*settings.packages, "goal_behind")
    count = min(settings.num_uavs, args.starts)
    env = make_env(chosen.env | turned, chosen.perception, packages=packages, seed=settings.seed, num_uavs=count)
    starts = first_steps(env, chosen.policy, args.starts, args.steps)
    env.close()
    tell(starts, args.steps)
    if args.json:
        rows = [start._asdict() for start in starts]
        args.json.write_text(json.dumps({"overrides": overrides, "starts": rows}, indent=1) + "\n", encoding="utf-8")


def tell(starts: list[Start], steps: int) -> None:
    """Prints what was found."""
    sides = Counter("left" if start.turned > 0 else "right" for start in starts)
    angles = np.percentile([start.angle for start in starts], (5, 50, 95))
    success = wilson(sum(start.outcome == "arrived" for start in starts), len(starts))
    rate, low, high = (100 * success[key] for key in ("rate", "low", "high"))
    for when, many in (
        (f"in {steps} steps", Counter(start.reversals for start in starts)),
        ("with the goal behind", Counter(start.behind for start in starts)),
    ):
        told = ", ".join(f"{number} in {many[number]}" for number in sorted(many))
        print(f"reversals of the yaw rate {when}: {told} of {len(starts)} starts")
    print(f"turned left in {sides['left']}, right in {sides['right']}")
    print(f"angle to the goal afterwards, 5 / 50 / 95 %: {' / '.join(f'{angle:.0f}' for angle in angles)} degrees")
    print(f"success {rate:.1f} % ({low:.1f}–{high:.1f})")


if __name__ == "__main__":
    with one_sentence():
        main()
