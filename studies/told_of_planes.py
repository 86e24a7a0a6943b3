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
from uavrl.rollout.rollout import fly
from uavrl.runs.episodes import wilson

Known = Literal["nothing", "in view, straight on", "all, straight on", "all, as they will fly"]
KNOWN: tuple[Known, ...] = ("nothing", "in view, straight on", "all, straight on", "all, as they will fly")
STEPS = 20  # that are looked ahead, two seconds
SPEEDS = torch.tensor([1.0, 0.5, 0.0])  # shares of the speed that the rule would fly at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between
IN_VIEW, ELEVATION = 10.0, math.radians(20.0)
FAR = 14.0  # m: two seconds at 4 + 2 m/s, and room; what is farther away is no threat


def places(told: Tensor, velocity: Tensor, times: Tensor) -> Tensor:
    """Where a vehicle will be ``[*B, T, 3]`` from here: its velocity comes to what it was told as a first-order lag."""
    lost = LAG * (1 - torch.exp(-times / LAG))
    return told[..., None, :] * (times - lost)[:, None] + velocity[..., None, :] * lost[:, None]


def threat(gap: Tensor, times: Tensor) -> Tensor:
    """How near one comes to a plane and how soon ``[*B]``, of what lies between ``[*B, T, 3]``; 0 is far."""
    apart = torch.maximum(gap[..., :2].norm(dim=-1) / WIDE, gap[..., 2].abs() / HIGH)  # below 1: too near
    share = times / times[-1]
    soon = (1.2 - 0.2 * share - apart).clamp_min(0) * (1 - 0.5 * share)
    return soon.amax(-1) + (apart < 1).any(-1).to(gap)


class ToldOfPlanes(VectorFieldHistogram):
    """The rule vfh that also keeps out of the planes' ways.

    Args:
        env: knows where the planes are.
        known: what it tells.
    """

    def __init__(self, env: NavigationEnv, known: Known) -> None:
        super().__init__(reduction="range_image", statistic="proximity")
        self.env, self.known = env, known
        self.times = torch.arange(1, STEPS + 1) / CONTROL_RATE

    def ways(self) -> tuple[Tensor, Tensor]:
        """Where the planes are ``[K, 3]``, and where they are thought to be later ``[K, T, 3]``."""
        now = torch.from_numpy(self.env.plane_poses())[:, :3].float()
        later = torch.from_numpy(self.env.plane_paths(STEPS))[..., :3].float().transpose(0, 1)
        if self.known == "all, as they will fly":
            return now, later
        return now, now[:, None] + (later[:, 0] - now)[:, None] * CONTROL_RATE * self.times[:, None]

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``."""
        cost, speed = self.score_directions(tensordict)
        yaw = torch.from_numpy(self.env.simulation.yaw).float()[:, None]
        x, y, z = self.directions.T
        ahead = [yaw.cos() * x - yaw.sin() * y, yaw.sin() * x + yaw.cos() * y, z.expand(len(yaw), -1)]
        told = torch.stack(ahead, -1)[:, :, None] * (speed[..., None] * SPEEDS)[..., None]  # [N, D, S, 3]
        now, later = self.ways()
        in_view = self.known == "in view, straight on"
        worst = torch.zeros(told.shape[:-1])
        for i, (place, velocity) in enumerate(zip(tensordict["position"], tensordict["velocity"], strict=True)):
            apart = now - place
            elevation = torch.atan2(apart[:, 2], apart[:, :2].norm(dim=-1)).abs()
            near = apart.norm(dim=-1) < (IN_VIEW if in_view else FAR)
            near &= (elevation < ELEVATION) | (not in_view)
            mine = place + places(told[i], velocity, self.times)
            for way in later[near]:
                worst[i] = torch.maximum(worst[i], threat(mine - way, self.times))
        rated = cost[..., None] + SLOWNESS * (1 - SPEEDS) + THREAT * worst
        least, share = rated.min(-1)
        return tensordict.set("action", self.to_action(least, SPEEDS[share] * speed, tensordict["heading_deg"]))


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
