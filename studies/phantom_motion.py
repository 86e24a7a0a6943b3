"""How often does motion detection see something move in a world where nothing moves?

Run `python studies/phantom_motion.py`. `policy=best` flies with all guards, whose evasion detects motion, with each
LiDAR in a valley and in rooms without aeroplanes. Each scan in which anything is reported counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import torch
from torchrl.envs.utils import step_mdp

from uavrl import load_policy
from uavrl.transforms.guarded import Guarded
from uavrl_onboard.cli.process import one_sentence

SENSORS = ("vlp16", "os0_32", "os0_128", "os1_64", "xt32", "mid360", "rplidar")
WORLDS = ("static", "rooms")


def phantoms(world: str, sensor: str, vehicles: int, steps: int) -> int:
    """In how many scans of several vehicles something is reported to move."""
    policy = load_policy("best")
    changes = (f"env={world}", "randomize=none", f"env.lidar={sensor}")
    env = policy.make_env(*changes, num_uavs=vehicles, valleys=[100], guards="all", allow_unseen=True)
    try:
        state = env.reset()
        guards = next(part for part in env.transform.modules() if isinstance(part, Guarded))
        reported = 0
        for _ in range(steps):
            state = step_mdp(env.step(policy(state)))
            assert guards._made is not None and guards._made._sight is not None
            reported += sum(len(bodies) > 0 for bodies in guards._made._sight.bodies)
    finally:
        env.close()
    return reported


def main(words: Sequence[str] | None = None) -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=list(SENSORS))
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--steps", type=int, default=50)
    args = parser.parse_args(words)
    torch.set_num_threads(1)
    print(f"| sensor | {' | '.join(args.worlds)} |\n|---{'|---' * len(args.worlds)}|")
    for sensor in args.sensors:
        found = [phantoms(world, sensor, args.vehicles, args.steps) for world in args.worlds]
        print(f"| `{sensor}` | {' | '.join(f'{each} of {args.vehicles * args.steps}' for each in found)} |", flush=True)


if __name__ == "__main__":
    with one_sentence():
        main()
