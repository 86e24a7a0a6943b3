"""How do planners with memory do in the tasks of the suite, beside the packaged policy and the scripted controller?

    python studies/rivals.py FOLDER --rows dense                      # all planners
    python studies/rivals.py FOLDER --rivals vfh_star --rows dense    # FOLDER keeps what has been flown

Each flies 500 tasks of each row by `uavrl-evaluate suite=...`, as many rows at a time as there are processors. They
are the tasks that `policy=best` has flown for its `suite.json`. The table tells success with Wilson's interval, the
difference to `policy=best` with Newcombe's for paired tasks and the p of McNemar, steps per success, milliseconds per
decision of one vehicle and of 16 at a time on one thread, without the scan, and how many lines of code the rival takes.
"""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from outcomes import compared, evaluation
from run_statistics import paired_difference

from uavrl.config import compose, validate
from uavrl.config.build import find_class
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.policies import BASELINES, PACKAGED, named_policy
from uavrl.evaluation.rollout import rollout
from uavrl.planners import ompl_search, point_memory, rrt_connect
from uavrl.runs.episodes import rate_cell, success_text, wilson
from uavrl.runs.machine import processors
from uavrl_onboard import geometry
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.guards import evade, histogram
from uavrl_onboard.guards.map import episode_map, goal_finder, lines, route

BEST = PACKAGED / "best/suite.json"
CELLS = ["perception=range_image", "perception.last_action=true"]
RIVALS: dict[str, list[str]] = {
    "vfh_star": [],
    "mppi": [],
    "potential_field": [],
    "rrt_connect": [],
    "rrt_map": [],
    "vfh": CELLS,
}
ROWS = ("static", "held_out", "dense")
SHARED = [point_memory, geometry, histogram, evade]  # of all that remember their scans


def fly(name: str, row: str, folder: Path, tasks: int) -> dict[str, Any]:
    """A row of the suite, flown by the command that anybody would use; what is there is not flown again."""
    chosen = [f"policy={name}", *RIVALS[name], f"suite=[{row}]", f"output={folder / name}", "progress=false"]
    command = [sys.executable, "-m", "uavrl", "evaluate", *chosen, f"episodes={tasks}"]
    code = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
    if code:
        raise UavrlError(
            f"{name}, {row}: uavrl evaluate has ended with {code}, and tells why above; start the same command again, "
            f"which flies what is missing."
        )
    found: dict[str, Any] = json.loads((folder / name / f"{row}.json").read_text(encoding="utf-8"))
    print(f"{name}, {row}: {success_text(found['success'], found['episodes'])}", file=sys.stderr, flush=True)
    return {key: value for key, value in found.items() if key != "flights"}


def milliseconds(name: str, vehicles: int, steps: int = 40) -> float:
    """Of one decision, in the middle of episodes in a dense valley: what the policy takes without the scan."""
    settings = validate(compose("env.world.obstacles=90", "env.world.seeds=[200]", *RIVALS[name]))
    told = {**settings.perception, "flight_level": settings.env.world.flight_level}
    policy, took = named_policy(name, told, ()), []

    def timed(tensordict: Any) -> Any:
        begun = time.perf_counter()
        acted = policy(tensordict)
        took.append(time.perf_counter() - begun)
        return acted

    seen: dict[str, Any] = {"keep_cloud": True, "mark_resets": True, "seed": 30_000, "num_uavs": vehicles}
    env = make_env(settings.env, settings.perception, **seen)
    try:
        for _, _ in zip(range(steps), rollout(env, timed, env.reset()), strict=False):
            pass
    finally:
        env.close()
    return 1e3 * sorted(took)[len(took) // 2] / vehicles


def lines_of(*modules: Any) -> int:
    """Lines on which code of modules begins: without blank ones, comments and docstrings."""
    count = 0
    for module in modules:
        tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
        strings = [
            node for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        ]
        texts = {*strings, *(node.value for node in strings)}
        count += len({node.lineno for node in ast.walk(tree) if hasattr(node, "lineno") and node not in texts})
    return count


def modules_of(name: str) -> list[Any]:
    """Where a rival's code is, beside what it shares with the controller and the learned policies."""
    kind = find_class(BASELINES[name], object)
    own = [sys.modules[kind.__module__]] + SHARED * issubclass(kind, point_memory.Planner)
    own += [ompl_search, lines] * issubclass(kind, rrt_connect.RRTConnect)
    return own + [rrt_connect, episode_map, goal_finder, route] * (name == "rrt_map")


def row_of(result: dict[str, Any], best: dict[str, Any] | None) -> list[str]:
    """What a table says of a row: success, difference to the best, steps per success."""
    arrived, tasks = result["outcomes"].count("S"), result["episodes"]
    success = rate_cell(wilson(arrived, tasks))
    steps = f"{result['steps_per_arrival']:.0f}" if arrived else "–"
    if best is None:
        return [success, "–", steps]
    best = {**best, "episodes": tasks, "outcomes": best["outcomes"][:tasks]}  # a task is the same among any number
    difference = "{:+.1f} ({:+.1f} to {:+.1f})".format(*paired_difference(result["outcomes"], best["outcomes"]))
    return [success, f"{difference}, p = {compared(result, best)['p']:.2g}", steps]


def main() -> None:
    """Flies what is missing and prints the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rivals", nargs="+", choices=RIVALS, default=list(RIVALS))
    parser.add_argument("--rows", nargs="+", default=list(ROWS))
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--json", type=Path, help="also put what was found into this file, without the single flights")
    args = parser.parse_args()
    torch.set_num_threads(1)
    pairs = [(name, row) for name in args.rivals for row in args.rows]
    with ThreadPoolExecutor(processors()) as pool:
        rows = list(pool.map(lambda pair: fly(*pair, args.folder, args.tasks), pairs))
    found: dict[str, dict[str, Any]] = {name: {} for name in args.rivals}
    for (name, row), each in zip(pairs, rows, strict=True):
        found[name][row] = each
    heads = [f"{row}: {told}" for row in args.rows for told in ("success, % (95 % CI)", "to `best`, points", "steps")]
    print(f"| policy | {' | '.join(heads)} | ms (1, 16 vehicles) | lines |")
    print("|---" * (len(heads) + 3) + "|")
    for name in args.rivals:
        cells = [cell for row in args.rows for cell in row_of(found[name][row], told_of_best(row))]
        times = ", ".join(f"{milliseconds(name, vehicles):.1f}" for vehicles in (1, 16))
        print(f"| `policy={name}` | {' | '.join(cells)} | {times} | {lines_of(*modules_of(name))} |", flush=True)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def told_of_best(row: str) -> dict[str, Any] | None:
    """What the packaged policy came to in a row of the suite; None where it has not flown it."""
    try:
        return evaluation(f"{BEST}:{row}")
    except UavrlError:
        return None


if __name__ == "__main__":
    with one_sentence():
        main()
