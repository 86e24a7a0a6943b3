"""How does a policy answer to a plane? Its action with the plane in the scan, less its action without.

    python benchmarks/reactions.py                       # the packaged dynamic policy, 1,000 steps of 16 vehicles
    python benchmarks/reactions.py --policy static --steps 2000 env.world.plane_speed=[2.5,2.5]

Every scan is taken twice, with and without the planes. Of the steps at which a plane is seen and passes within reach
if both keep their velocities, it tells by how much the policy brakes, and moves sideways and up or down out of the
plane's way (negative: into it), by the time that is left.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from common import experiment
from torchrl.envs.utils import step_mdp

from uavrl.cli.policies import policy_folder
from uavrl.envs import NavigationEnv
from uavrl.training.factory import make_env
from uavrl.training.policies import load_policy
from uavrl.transforms.functional import truncated_icosahedron

VEHICLES = 16
NUMBERS = 35  # in one frame: 32 faces, the altitude and two angles
BESIDE, ABOVE = 1.6, 1.0  # m between the two middles within which a pass is a danger
TIMES = (0.05, 0.3, 0.6, 0.9, 1.3, 2.0)  # s


def faces_without_planes(base: NavigationEnv, radius: float) -> torch.Tensor:
    """The last scan's faces ``[N, 32]`` over the radius, as they are where no plane is."""
    simulation, lidar = base.simulation, base._lidar
    assert lidar is not None
    points = lidar.scan(simulation.lidar_position, simulation.rotation, None, rng=np.random.default_rng(0))
    return truncated_icosahedron(torch.as_tensor(np.ascontiguousarray(points)), radius) / radius


def passes(base: NavigationEnv, velocities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When the nearest plane passes each vehicle in s ``[N]``, and where from it: ``[N, 3]``, forward, left, up."""
    poses, position, yaw = base.plane_poses(), base.simulation.position, base.simulation.yaw
    nearest = np.linalg.norm(poses[None, :, :3] - position[:, None], axis=2).argmin(1)
    offset = poses[nearest, :3] - position
    relative = velocities[nearest] - base.simulation.velocity
    time = np.clip(-(offset * relative).sum(1) / ((relative**2).sum(1) + 1e-9), 0.0, 3.0)
    miss = offset + time[:, None] * relative
    forward = miss[:, 0] * np.cos(yaw) + miss[:, 1] * np.sin(yaw)
    left = miss[:, 1] * np.cos(yaw) - miss[:, 0] * np.sin(yaw)
    return time, np.column_stack([forward, left, miss[:, 2]])


@torch.no_grad()
def reactions(config: Any, policy: Any, steps: int) -> np.ndarray:
    """Rows of time to the pass, where it passes (3) and what the plane changes in the action (4)."""
    env = make_env(config.env, config.perception, config.reward, seed=20_000, num_uavs=VEHICLES)
    base = env.base_env
    assert isinstance(base, NavigationEnv)
    state, rows, before = env.reset(), [], base.plane_poses()
    hidden = state["observation"].unflatten(-1, (-1, NUMBERS)).clone()
    for _ in range(steps):
        seen = state["observation"].unflatten(-1, (-1, NUMBERS))
        hidden[:, -1, :32] = faces_without_planes(base, config.perception.radius)
        shown = ((seen - hidden)[:, -1, :32].abs() > 0.05).any(-1).numpy()
        acted = policy(state.select("observation"))["action"]
        unseeing = policy(state.select("observation").set("observation", hidden.flatten(1)))["action"]
        velocities = (base.plane_poses() - before)[:, :3] * 10  # m/s, over the last 0.1 s
        time, miss = passes(base, velocities)
        danger = shown & (np.hypot(miss[:, 0], miss[:, 1]) < BESIDE) & (abs(miss[:, 2]) < ABOVE)
        rows.append(np.column_stack([time, miss, (acted - unseeing).numpy()])[danger])
        before = base.plane_poses()
        state = env.step(state.set("action", acted))
        ended = state["next", "done"]
        state = step_mdp(state)
        if ended.any():
            state = env.reset(state.set("_reset", ended))
        now = state["observation"].unflatten(-1, (-1, NUMBERS))
        hidden = torch.where(ended[..., None], now, torch.cat([hidden[:, 1:], now[:, -1:]], 1))
    env.close()
    return np.concatenate(rows)


def main() -> None:
    """Prints one line for each span of time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default="dynamic", help="a packaged policy")
    parser.add_argument("--run", help="a run folder instead")
    parser.add_argument("--steps", type=int, default=1000)
    args, overrides = parser.parse_known_args()
    folder = policy_folder(args.run, None if args.run else args.policy)
    assert folder is not None, "a policy that learns nothing reads no observation"
    rows = reactions(experiment("env=dynamic", *overrides), load_policy(folder, None, "cpu")[1], args.steps)
    print(f"{'time to the pass':<18}{'steps':>7}{'brakes':>9}{'sideways':>10}{'up or down':>12}   m/s")
    for low, high in pairwise(TIMES):
        chosen = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if not len(chosen):
            continue
        sides = -np.sign(chosen[:, 2:4]) * chosen[:, 5:7]  # out of the way
        told = (-chosen[:, 4].mean(), *sides.mean(0))
        print(f"{low:.2f} to {high:.1f} s{len(chosen):>13}{told[0]:>+9.2f}{told[1]:>+10.2f}{told[2]:>+12.2f}")


if __name__ == "__main__":
    main()
