"""What knowing of the planes is worth: the rule vfh, told where they are and how they fly.

    python studies/told_of_planes.py --tasks 192 [--valleys 300] [--json FILE] [OVERRIDES]

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

from uavrl.config import compose, validate
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.policies.baselines import VectorFieldHistogram
from uavrl.runs.episodes import rate_cell, wilson
from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.geometry import world_to_yaw
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.perception.motion.threats import TIMES

SIGHTS = {"nothing": 0.0, "in view within 8 m": 8.0, "in view within 10 m": 10.0, "in view within 14 m": 14.0}
ALL = "all within 14 m, as they will fly"
KNOWN = (*SIGHTS, ALL)
ELEVATION = math.radians(15.0)  # of the highest and the lowest beam
FAR = 14.0  # m: two seconds at 4 + 2 m/s, and room; what is farther away is no threat


class ToldOfPlanes(VectorFieldHistogram):
    """The rule vfh that also keeps out of the planes' ways.

    Args:
        env: knows where the planes are.
        known: which of them it tells of, and how: one of ``KNOWN``.
    """

    def __init__(self, env: NavigationEnv, known: str) -> None:
        super().__init__(reduction="range_image", statistic="proximity", motion=FAR)
        self.env, self.known, self.sight = env, known, SIGHTS.get(known, FAR)
        solid = Mesh.merge(env.world.meshes)
        self.obstacles = EmbreeScene()
        TriangleMesh(self.obstacles, solid.vertices, solid.faces)

    def ways(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Where the planes are thought to be later, seen from each vehicle ``[N, K, T, 3]``, and which it knows."""
        place, now = tensordict["position"], torch.from_numpy(self.env.plane_poses())[:, :3].float()
        steps = len(TIMES) if self.known == ALL else 1
        later = torch.from_numpy(self.env.plane_paths(steps))[..., :3].float().transpose(0, 1)
        if self.known != ALL:
            later = now[:, None] + (later[:, 0] - now)[:, None] * CONTROL_RATE * torch.from_numpy(TIMES)[:, None]
        known = self.known_of(place, now)
        seen = call_numpy(world_to_yaw, later - place[:, None, None], tensordict["attitude"][:, 2])
        return seen, known

    def known_of(self, place: Tensor, now: Tensor) -> Tensor:
        """Which of the planes at ``now [K, 3]`` vehicles at ``place [N, 3]`` are told of: ``bool [N, K]``."""
        apart = now - place[:, None]
        distance = apart.norm(dim=-1)
        known = distance < self.sight
        if self.known != ALL:
            known &= (apart[..., 2] / distance).asin().abs() < ELEVATION
            at = known.nonzero(as_tuple=True)
            clear = distance[at].numpy().copy()
            directions = (apart[at] / distance[at][:, None]).numpy()
            self.obstacles.run(place[at[0]].contiguous().numpy(), directions, clear, query="DISTANCE")
            known[at] = torch.from_numpy(clear) >= distance[at] - 1e-3
        return known


def main() -> None:
    """Flies with each knowledge, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tasks", type=int, default=192)
    parser.add_argument("--valleys", type=int, default=200, help="the first of ten")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    args, overrides = parser.parse_known_args()
    torch.set_num_threads(1)
    valleys = f"env.world.seeds={list(range(args.valleys, args.valleys + 10))}".replace(" ", "")
    chosen = ["env=dynamic", "env.num_uavs=16", valleys, "perception=range_image", *overrides]
    settings = validate(compose(*chosen))
    result: dict[str, dict[str, float]] = {}
    print("| told of planes | success, % (95 % CI) | collided | timed out | more than told of none |")
    print("|---|---|---|---|---|")
    for known in KNOWN:
        env = make_env(settings.env, settings.perception, seed=30_000)
        rule = VectorFieldHistogram(reduction="range_image", statistic="proximity")
        if known != "nothing":
            rule = ToldOfPlanes(env.base_env, known)
        outcomes = [flight.outcome for flight in rollout_episodes(env, rule, args.tasks)]
        env.close()
        row = {end: outcomes.count(end) for end in ("arrived", "collided", "timed_out")}
        rate = wilson(row["arrived"], args.tasks)
        result[known] = {**row, **rate}
        more = difference_of_rates(rate, result[KNOWN[0]])
        gain = "{:+.1f} ({:+.1f} to {:+.1f})".format(*(100 * each for each in more)) if known != KNOWN[0] else ""
        print(f"| {known} | {rate_cell(rate)} | {row['collided']} | {row['timed_out']} | {gain} |", flush=True)
    if args.json:
        args.json.write_text(
            json.dumps({"tasks": args.tasks, "overrides": chosen, "known": result}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    with one_sentence():
        main()
