"""What knowing of the planes is worth: the rule vfh, told where they are and how they fly.

    python studies/told_of_planes.py --tasks 96 [--valleys 300] [--json FILE] [OVERRIDES]

In ten valleys of the default's density, with three planes each; the rule's numbers were chosen in those from 200 on.
The rule on 72 cells has no memory, so to it a plane is an obstacle that stands. Told, it also keeps out of the planes'
ways for two seconds: of those within 10 m and 20 degrees of the horizon, as if they flew straight on; of those within
14 m likewise; and of these on the ways that they will really fly. It is told through obstacles, too, and without error.
The same tasks for all, but the planes are elsewhere on their ways when a later task begins.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Literal

import torch
from run_statistics import difference_of_rates
from tensordict import TensorDictBase
from torch import Tensor

from uavrl.cli.errors import one_sentence
from uavrl.config import compose, validate
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.rollout.baselines import VectorFieldHistogram
from uavrl.rollout.environment import make_env
from uavrl.rollout.evasion import TIMES, to_yaw
from uavrl.rollout.rollout import fly
from uavrl.runs.episodes import wilson

Known = Literal["nothing", "in view, straight on", "all, straight on", "all, as they will fly"]
KNOWN: tuple[Known, ...] = ("nothing", "in view, straight on", "all, straight on", "all, as they will fly")
IN_VIEW, ELEVATION = 10.0, math.radians(20.0)
FAR = 14.0  # m: two seconds at 4 + 2 m/s, and room; what is farther away is no threat


class ToldOfPlanes(VectorFieldHistogram):
    """The rule vfh that also keeps out of the planes' ways.

    Args:
        env: knows where the planes are.
        known: what it tells.
    """

    def __init__(self, env: NavigationEnv, known: Known) -> None:
        super().__init__(reduction="range_image", statistic="proximity", motion=FAR)
        self.env, self.known = env, known

    def ways(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Where the planes are thought to be later, seen from each vehicle ``[N, K, T, 3]``, and which it knows."""
        now = torch.from_numpy(self.env.plane_poses())[:, :3].float()
        later = torch.from_numpy(self.env.plane_paths(len(TIMES)))[..., :3].float().transpose(0, 1)
        if self.known != "all, as they will fly":
            later = now[:, None] + (later[:, 0] - now)[:, None] * CONTROL_RATE * TIMES[:, None]
        place = tensordict["position"]
        apart = now - place[:, None]
        near = apart.norm(dim=-1) < (IN_VIEW if self.known == "in view, straight on" else FAR)
        if self.known == "in view, straight on":
            near &= torch.atan2(apart[..., 2], apart[..., :2].norm(dim=-1)).abs() < ELEVATION
        return to_yaw(later - place[:, None, None], tensordict["attitude"][:, 2]), near


def main() -> None:
    """Flies all four, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tasks", type=int, default=96)
    parser.add_argument("--valleys", type=int, default=200, help="the first of ten")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args, overrides = parser.parse_known_args()
    torch.set_num_threads(1)
    valleys = f"env.world.seeds={list(range(args.valleys, args.valleys + 10))}".replace(" ", "")
    chosen = ["env=dynamic", "env.num_uavs=16", valleys, "perception=range_image", *overrides]
    settings = validate(compose(*chosen))
    result: dict[str, dict[str, float]] = {}
    print("| told of planes | arrived | collided | timed out | more than told of none |\n|---|---|---|---|---|")
    for known in KNOWN:
        env = make_env(settings.env, settings.perception, seed=30_000)
        rule = VectorFieldHistogram(reduction="range_image", statistic="proximity")
        if known != "nothing":
            rule = ToldOfPlanes(env.base_env, known)
        outcomes = [flight.outcome for flight in fly(env, rule, args.tasks)]
        env.close()
        row = {end: outcomes.count(end) for end in ("arrived", "collided", "timed_out")}
        rate = wilson(row["arrived"], args.tasks)
        told = f"{100 * rate['rate']:.1f} % ({100 * rate['low']:.1f}–{100 * rate['high']:.1f})"
        result[known] = {**row, **rate}
        more = difference_of_rates(rate, result[KNOWN[0]])
        gain = "{:+.1f} ({:+.1f} to {:+.1f})".format(*(100 * each for each in more)) if known != KNOWN[0] else ""
        print(f"| {known} | {told} | {row['collided']} | {row['timed_out']} | {gain} |", flush=True)
    if args.json:
        args.json.write_text(
            json.dumps({"tasks": args.tasks, "overrides": chosen, "known": result}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    with one_sentence():
        main()
