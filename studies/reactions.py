"""How does a policy answer to a plane? Its action with the plane in the scan, less its action without.

    python studies/reactions.py                       # policy=best, 1,000 steps of 16 vehicles
    python studies/reactions.py --policy best --steps 2000 env.world.plane_speed=[2.5,2.5]

Every scan is taken twice, with and without the planes. Of the steps at which a plane is seen and passes within reach
if both keep their velocities, it tells by how much the policy brakes, and moves sideways and up or down out of the
plane's way (negative: into it), by the time that is left.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from passes import TIMES, among_planes, moments
from tensordict import TensorDict, TensorDictBase

from uavrl.config import TrainConfig
from uavrl.evaluation.policies import policy_folder
from uavrl_onboard.cli.process import one_sentence


@torch.no_grad()
def reactions(config: TrainConfig, policy: Callable[[TensorDictBase], TensorDictBase], steps: int) -> np.ndarray:
    """Rows of time to the pass, where it passes (3) and what the plane changes in the action (4)."""
    rows = []
    for now in moments(config, policy, steps):
        unseeing = policy(TensorDict({"observation": now.hidden.flatten(1)}, now.hidden.shape[:1]))["action"]
        rows.append(np.column_stack([now.time, now.miss, (now.acted - unseeing).numpy()])[now.danger])
    return np.concatenate(rows)


def main() -> None:
    """Prints one line for each span of time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", default="best", help="a packaged policy")
    parser.add_argument("--run", help="a run folder instead")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    args, overrides = parser.parse_known_args()
    folder = policy_folder(args.run, None if args.run else args.policy)
    assert folder is not None, "a policy that learns nothing reads no observation"
    rows = reactions(*among_planes(folder, *overrides), args.steps)
    print(f"{'time to the pass':<18}{'steps':>7}{'brakes':>9}{'sideways':>10}{'up or down':>12}   m/s")
    told = []
    for low, high in pairwise(TIMES):
        chosen = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if not len(chosen):
            continue
        sides = -np.sign(chosen[:, 2:4]) * chosen[:, 5:7]  # out of the way
        brakes, (sideways, vertically) = float(-chosen[:, 4].mean()), sides.mean(0).tolist()
        told.append({"from": low, "to": high, "steps": len(chosen), "brakes": brakes})
        told[-1] |= {"sideways": sideways, "vertically": vertically}
        print(f"{low:.2f} to {high:.1f} s{len(chosen):>13}{brakes:>+9.2f}{sideways:>+10.2f}{vertically:>+12.2f}")
    if args.json:
        args.json.write_text(
            json.dumps({"policy": str(args.run or args.policy), "answers": told}, indent=1), encoding="utf-8"
        )


if __name__ == "__main__":
    with one_sentence():
        main()
