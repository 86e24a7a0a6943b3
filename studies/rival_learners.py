"""How do the literature's learners do beside the library's, with as many steps of the same valley?

python studies/rival_learners.py FOLDER [--learners td3 mep_ddpg] [--seeds 0 1] [--json FILE]

Trains what FOLDER does not hold yet, evaluates it, and prints the table: one process at a time, in some minutes of one
core for each training. A run that was stopped goes on. With ``--only-read`` nothing is flown. The learners are those of
``studies/learners``.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from uavrl.runs.episodes import rate_cell, wilson
from uavrl_onboard.cli.process import one_sentence

ROOT = Path(__file__).resolve().parents[1]
OWN = ROOT / "studies/learners"
STEPS, PILOT_STEPS, TASKS = 20_000, 4_000, 200
WORLDS = ("static", "held_out")
SAME = [
    "perception=range_image",
    "algo.hidden=[256,256]",
    f"algo.learning_starts={PILOT_STEPS}",
    f"trainer.steps={STEPS}",
    "trainer.window=100",
    "trainer.progress=false",
]
LEARNERS = {
    "ddpg": ["learner=ddpg"],
    "td3": ["learner=td3"],
    "mep_ddpg": ["learner=mep_ddpg", f"buffer.until={STEPS // 2}"],
    "td3_alternative": ["learner=td3_alternative"],
    "imitation": ["learner=td3", "demonstrator=vfh", "actor_penalty=imitation"],  # the library's own way
    "ddpg_guided": ["learner=ddpg", "demonstrator=vfh"],  # mep_ddpg with one pool
}


def command(name: str, *arguments: str) -> list[str]:
    """One of uavrl's commands with the learners' door open."""
    return [sys.executable, "-m", "uavrl", name, *arguments, "packages=[learners]"]


def training(learner: str, seed: int, run: Path) -> list[str]:
    """The command that trains, or that goes on."""
    if (run / "summary.json").exists():
        return []
    if list(run.glob("checkpoints/*")):
        return command("train", f"resume={run}")
    chosen = [*LEARNERS[learner], *SAME, f"seed={seed}", f"run_dir={run}"]
    return command("train", "--config-dir", str(OWN / "conf"), *chosen)


def fly(learner: str, seed: int, run: Path) -> None:
    """Trains and evaluates what is missing."""
    path = os.pathsep.join([str(OWN), str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    if todo := training(learner, seed, run):
        subprocess.run(todo, check=True, env=environment)
    for count in range(1, len(WORLDS) + 1):  # one more at a time: what is there already is not flown again
        if found(run) is None:
            worlds = f"suite=[{','.join(WORLDS[:count])}]"
            flown = [worlds, f"episodes={TASKS}", f"output={run / 'suite'}", "progress=false"]
            subprocess.run(command("evaluate", f"run={run}", *flown), check=True, env=environment)


def found(run: Path) -> dict[str, Any] | None:
    """What a run came to; None where it is not evaluated yet."""
    suite = run / "suite/suite.json"
    rows = json.loads(suite.read_text(encoding="utf-8")) if suite.exists() else {}
    if not set(WORLDS) <= set(rows):
        return None
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    kept = ("episodes", "outcomes", "steps_per_arrival", "seed")
    told = {world: {key: rows[world][key] for key in kept if key in rows[world]} for world in WORLDS}
    return {**told, "steps": summary["steps"], "updates": summary["updates"], "commit": summary["versions"]["commit"]}


def row(name: str, result: dict[str, Any]) -> str:
    """A line of the table."""
    cells = []
    for world in WORLDS:
        ends = result[world]["outcomes"]
        rate = rate_cell(wilson(ends.count("S"), len(ends)))
        cells += [rate, f"{100 * ends.count('C') / len(ends):.1f}"]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Trains, evaluates, prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--only-read", action="store_true")
    parser.add_argument("--json", type=Path, help="also put what was found into this file")
    args = parser.parse_args()
    results: dict[str, Any] = {}
    print("| learner, seed | " + " | ".join(f"{world}: success, % (95 % CI) | collision, %" for world in WORLDS) + " |")
    print("|---" * (1 + 2 * len(WORLDS)) + "|")
    for seed in args.seeds:
        for learner in args.learners:
            run = args.folder / f"{learner}_seed{seed}"
            if not args.only_read:
                fly(learner, seed, run)
            if (result := found(run)) is not None:
                results[run.name] = result
                print(row(f"{learner}, {seed}", result), flush=True)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with one_sentence():
        main()
