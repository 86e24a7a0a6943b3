"""How does an exported policy do that knows its vehicle by packets and MAVLink alone?

    uavrl-export policy=best output=FOLDER
    PYTHONPATH=. python studies/over_mavlink.py FOLDER --tasks 60
    PYTHONPATH=. python studies/over_mavlink.py FOLDER --row dynamic --tasks 60 --guards evasion

The guards are those of the policy's contract, or those that are named. The tasks are those of the suite's row `traps`,
or `dynamic`. In each the simulator stands still until a set-point has
come: whole scans as VLP-16 packets, the pose as MAVLink, `uavrl_onboard.flight.loop.Flight` as in `uavrl-fly`. One
letter a task tells how it ended: S for success, C for collision, T for time-out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import torch

from tests.helpers.wire import Wire
from uavrl.config import compose, validate
from uavrl.evaluation.environment import make_env
from uavrl.runs.episodes import success_text, wilson
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.policy.contract import read_contract

SENSES = ["perception=range_image", "perception.last_action=true", "perception.lidar.max_range=14"]
ROWS = {
    "traps": ["env=static", f"env.world.seeds={list(range(100, 110))}", "env.world.traps=3", "env.world.obstacles=20"],
    "dynamic": ["env=dynamic"],
}
SEED = 20_000  # of the suite's tasks


def flights(folder: Path, world: list[str], tasks: range, names: list[str] | None) -> Iterator[tuple[str, int]]:
    """How each of the tasks ended, and after how many steps."""
    contract, settings = read_contract(folder), validate(compose("run_dir=here", *world))
    env = make_env(settings.env, settings.perception, tasks=tasks, seed=SEED, num_uavs=1, keep_cloud=True)
    chosen = guard_settings(names, contract.guard_settings)
    for task in tasks:
        state, steps = env.reset(task=task), 0
        with closing(Wire(folder, env, task, guards=Guards(chosen, 1, contract.vehicle))) as wire:
            wire.hand_over(state["point_cloud"][0].numpy())
            while not state["done"].any():
                wire.cycle(state["point_cloud"][0].numpy())
                action = torch.as_tensor(wire.command(), dtype=torch.float32)[None]
                state, steps = env.step(state.set("action", action))["next"], steps + 1
        yield "S" if state["arrived"].any() else "C" if state["collided"].any() else "T", steps
    env.close()


def main() -> None:
    """Flies, and tells."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="what uavrl-export wrote")
    parser.add_argument("--tasks", type=int, default=60)
    parser.add_argument("--guards", nargs="+", help="names, all or none; by default those of the policy's contract")
    parser.add_argument("--row", choices=ROWS, default="traps", help="of the suite")
    parser.add_argument("--world", nargs="+", help="overrides in place of those of the row")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    outcomes, world = "", [*(args.world or ROWS[args.row]), *SENSES]
    for outcome, steps in flights(args.folder, world, range(args.tasks), args.guards):
        outcomes += outcome
        print(f"task {len(outcomes) - 1}: {outcome} after {steps} steps", flush=True)
    found = wilson(outcomes.count("S"), len(outcomes))
    print(success_text(found, len(outcomes)))
    if args.json:
        content = {"row": args.row, "guards": args.guards, "outcomes": outcomes, "success": found}
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
