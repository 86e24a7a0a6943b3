"""How much would giving way to the planes bring? A policy that does not see them, and the same with a reflex that does.

    python studies/planes.py                          # policy=best among ten planes, 240 tasks
    python studies/planes.py --episodes 500 env.world.plane_speed=[2.5,2.5]

The reflex knows where each plane is and where it heads, as no policy does: once any part of one is nearer than the
reduction's radius and comes on, it climbs or dives at full speed until it is out of the plane's height. What it gains
is what a learned policy could gain at least; where it gains little, planes cannot be given way to.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from passes import among_planes
from tensordict import TensorDictBase

from uavrl.envs import NavigationEnv
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.policies import policy_folder
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.runs.episodes import success_text, wilson
from uavrl.runs.provenance import versions
from uavrl.transforms.state import ACTION_LIMIT
from uavrl_onboard.cli.process import one_sentence

Policy = Callable[[TensorDictBase], TensorDictBase]
ROOM = 0.5  # m between hull and plane, along z, that the reflex wants
BESIDE = 1.5  # m off a plane's line within which it can hit
LOW, HIGH = 1.0, 4.3  # m, altitudes beyond which the reflex goes the other way


def climbs_or_dives(position: np.ndarray, pose: np.ndarray, mesh: np.ndarray, sight: float) -> int:
    """1 to climb, -1 to dive, 0 where a plane at ``pose`` (x, y, z, yaw) with corners ``mesh [V, 3]`` is no danger."""
    ahead, left = np.array([np.cos(pose[3]), np.sin(pose[3])]), np.array([-np.sin(pose[3]), np.cos(pose[3])])
    corners = np.column_stack([mesh[:, :1] * ahead + mesh[:, 1:2] * left, mesh[:, 2]]) + pose[:3]
    off = (position - pose[:3])[:2]
    if np.linalg.norm(corners - position, axis=1).min() > sight or off @ ahead < -1.0 or abs(off @ left) > BESIDE:
        return 0
    low, high = corners[:, 2].min(), corners[:, 2].max()
    up = bool(position[2] >= (low + high) / 2)
    up = (up or bool(position[2] < LOW)) and not position[2] > HIGH
    gap = position[2] - high if up else low - position[2]
    return (1 if up else -1) if gap < ROOM else 0


def with_reflex(policy: Policy, env: NavigationEnv, sight: float) -> Policy:
    """The policy's action, but for the vertical speed near a plane."""
    mesh = env.plane_mesh.vertices

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        acted, poses = policy(tensordict), env.plane_poses()
        for vehicle, position in enumerate(tensordict["position"].double().numpy()):
            for pose in poses:
                if way := climbs_or_dives(position, pose, mesh, sight):
                    acted["action"][vehicle, 2] = way * ACTION_LIMIT
        return acted

    return act


def main() -> None:
    """Flies the same tasks with and without the reflex."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=240)
    parser.add_argument("--policy", default="best", help="a packaged policy")
    parser.add_argument("--json", type=Path)
    args, overrides = parser.parse_known_args()
    folder = policy_folder(None, args.policy)
    assert folder is not None, "a policy that learns nothing reads no observation"
    config, policy = among_planes(folder, "perception.blind_to=planes", *overrides)
    found: dict[str, Any] = {"versions": versions(), "overrides": overrides, "episodes": args.episodes}
    for name in ("sees no plane", "with the reflex"):
        env = make_env(config.env, config.perception, config.reward, seed=20_000, num_uavs=16)
        base = env.base_env
        assert isinstance(base, NavigationEnv)
        flies = policy if name == "sees no plane" else with_reflex(policy, base, config.perception.radius)
        arrived = sum(
            flight.outcome == "arrived" for flight in rollout_episodes(env, flies, args.episodes, progress=True)
        )
        found[name] = wilson(arrived, args.episodes)
        print(f"{name:16} {success_text(found[name], args.episodes)}", flush=True)
        env.close()
    if args.json:
        args.json.write_text(json.dumps(found, indent=2), encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
