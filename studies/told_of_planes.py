"""What knowing of the planes is worth: the rule vfh, told where they are and how they fly.

    python studies/told_of_planes.py --tasks 500 [--valleys 300] [--json FILE] [OVERRIDES]

In ten valleys of `env=dynamic`; the rule's numbers were chosen in those from 200 on. The rule on 72 cells has no
memory, so to it a plane is an obstacle that stands. Told, it also keeps out of the planes' ways for two seconds: of
those in view within 8, 10 or 14 m, as if they flew straight on; and of all within 14 m on the ways that they will
really fly. In view is what no obstacle hides and the LiDAR's beams, 15 degrees up and down, can meet. The rule is told
without error. The same tasks for all, but the planes are elsewhere on their ways when a later task begins.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from run_statistics import difference_of_rates
from tensordict import TensorDictBase
from torch import Tensor

from uavrl.cli.errors import one_sentence
from uavrl.config import compose, validate
from uavrl.envs.mesh import Mesh
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.rollout.baselines import VectorFieldHistogram
from uavrl.rollout.environment import make_env
from uavrl.rollout.rollout import fly
from uavrl.runs.episodes import wilson

SIGHTS = {"nothing": 0.0, "in view within 8 m": 8.0, "in view within 10 m": 10.0, "in view within 14 m": 14.0}
ALL = "all within 14 m, as they will fly"
KNOWN = (*SIGHTS, ALL)
STEPS = 20  # that are looked ahead, two seconds
SPEEDS = torch.tensor([1.0, 0.5, 0.0])  # shares of the speed that the rule would fly at
SLOWNESS, THREAT = 0.3, 3.0  # what standing costs, and a collision; chosen by hand
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between
ELEVATION = math.radians(15.0)  # of the highest and the lowest beam
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
        known: which of them it tells of, and how: one of ``KNOWN``.
    """

    def __init__(self, env: NavigationEnv, known: str) -> None:
        super().__init__(reduction="range_image", statistic="proximity", last_action=True)
        self.env, self.known, self.sight = env, known, SIGHTS.get(known, FAR)
        self.times = torch.arange(1, STEPS + 1) / CONTROL_RATE
        self.obstacles = EmbreeScene()
        solid = Mesh.merge(env.world.meshes)
        TriangleMesh(self.obstacles, solid.vertices, solid.faces)

    def ways(self) -> tuple[Tensor, Tensor]:
        """Where the planes are ``[K, 3]``, and where they are thought to be later ``[K, T, 3]``."""
        now = torch.from_numpy(self.env.plane_poses())[:, :3].float()
        later = (
            torch.from_numpy(self.env.plane_paths(STEPS if self.known == ALL else 1))[..., :3].float().transpose(0, 1)
        )
        if self.known == ALL:
            return now, later
        return now, now[:, None] + (later[:, 0] - now)[:, None] * CONTROL_RATE * self.times[:, None]

    def told_of(self, place: Tensor, now: Tensor) -> Tensor:
        """Which of the planes at ``now [K, 3]`` a vehicle at ``place [3]`` is told of: ``bool [K]``."""
        apart = now - place
        distance = apart.norm(dim=-1)
        told = distance < self.sight
        if self.known != ALL and told.any():
            span = math.atan2(self.env.world.config.plane_wingspan / 4, self.sight)  # half of a plane's height
            told &= (apart[:, 2] / distance).asin().abs() < ELEVATION + span
            at = told.nonzero()[:, 0]
            origins = place.expand(len(at), 3).contiguous().numpy()
            clear = distance[at].numpy().copy()
            self.obstacles.run(origins, (apart[at] / distance[at, None]).numpy(), clear, query="DISTANCE")
            told[at] &= torch.from_numpy(clear) >= distance[at] - 1e-3
        return told

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action``."""
        cost, speed = self.score_directions(tensordict)
        yaw = torch.from_numpy(self.env.simulation.yaw).float()[:, None]
        x, y, z = self.directions.T
        ahead = [yaw.cos() * x - yaw.sin() * y, yaw.sin() * x + yaw.cos() * y, z.expand(len(yaw), -1)]
        told = torch.stack(ahead, -1)[:, :, None] * (speed[..., None] * SPEEDS)[..., None]  # [N, D, S, 3]
        now, later = self.ways()
        worst = torch.zeros(told.shape[:-1])
        for i, (place, velocity) in enumerate(zip(tensordict["position"], tensordict["velocity"], strict=True)):
            mine = place + places(told[i], velocity, self.times)
            for way in later[self.told_of(place, now)]:
                worst[i] = torch.maximum(worst[i], threat(mine - way, self.times))
        rated = cost[..., None] + SLOWNESS * (1 - SPEEDS) + THREAT * worst
        least, share = rated.min(-1)
        return tensordict.set("action", self.to_action(least, SPEEDS[share] * speed, tensordict["heading_deg"]))


def main() -> None:
    """Flies all four, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--valleys", type=int, default=200, help="the first of ten")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args, overrides = parser.parse_known_args()
    torch.set_num_threads(1)
    valleys = f"env.world.seeds={list(range(args.valleys, args.valleys + 10))}".replace(" ", "")
    seen = ["perception=range_image", "perception.last_action=true"]
    chosen = ["env=dynamic", "env.num_uavs=16", valleys, *seen, *overrides]
    settings = validate(compose(*chosen))
    result: dict[str, dict[str, float]] = {}
    print("| told of planes | arrived | collided | timed out | more than told of none |\n|---|---|---|---|---|")
    for known in KNOWN:
        env = make_env(settings.env, settings.perception, seed=30_000)
        rule = VectorFieldHistogram(reduction="range_image", statistic="proximity", last_action=True)
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
