"""Makes a packaged policy, ``uavrl/policies/data/NAME``, of a run and of what the suite found of it.

    uavrl-evaluate run=RUN_FOLDER suite=all                # writes RUN_FOLDER/suite, an hour or more
    python -m tools.package_policy best RUN_FOLDER --guards all   # from the root, all changes committed

The folder then holds the weights with ``policy.json``, which names the versions that trained them, the configuration,
``contract.json``, ``suite.json`` with the outcome of each task, the model card, and states with their actions, by which
the policy is tested on any processor. What it held before is replaced, except for ``card.yaml``.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import torch

from tests.helpers.recorded import record_actions
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import PACKAGED
from uavrl.evaluation.suite import scenarios
from uavrl.export.export import export_policy
from uavrl.export.model_card import STATEMENTS, write_card
from uavrl.runs.provenance import commit
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.guards.settings import guard_settings

TASKS = 500  # of each scenario


def rows(suite: Path, about: dict[str, Any]) -> dict[str, Any]:
    """The rows of a suite, found to be complete and of the policy that ``policy.json`` tells of."""
    try:
        found = json.loads(suite.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UavrlError(f"Expected {suite}: write it with uavrl-evaluate run=RUN_FOLDER suite=all.") from error
    wanted = {key: about.get(key) for key in ("checkpoint", "training_steps")}
    for name, overrides in scenarios("all").items():
        row = found.get(name, {})
        changed = [each for each in row.get("overrides", []) if not each.startswith(("num_uavs=", "policy="))]
        wrong = [key for key, value in {"episodes": TASKS, **wanted}.items() if row.get(key) != value]
        wrong += ["overrides"] if changed != overrides else []
        wrong += ["outcomes"] if len(row.get("outcomes") or "") != TASKS else []
        if wrong:
            raise UavrlError(
                f"{suite} has no {TASKS} tasks of {name} with this policy (see {', '.join(wrong)}): evaluate it with "
                f"uavrl-evaluate run=RUN_FOLDER suite=all, and name no checkpoint that it was not evaluated with."
            )
    return {name: {key: value for key, value in found[name].items() if key != "run"} for name in scenarios("all")}


def package(name: str, run: Path, suite: Path, checkpoint: str | None = None, guards: Any = None) -> Path:
    """Makes the folder of a policy that flies with these guards by default, and returns it."""
    if "dirty" in (commit() or "dirty"):
        raise UavrlError("Expected a checkout without changes, whose commit the contract names: commit them first.")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / name
        about = export_policy(run, checkpoint, folder, network=False, guards=guard_settings(guards))
        lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(row)}" for key, row in rows(suite, about).items())
        (folder / "suite.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
        if (PACKAGED / name / STATEMENTS).is_file() and not (folder / STATEMENTS).is_file():
            shutil.copy(PACKAGED / name / STATEMENTS, folder)
        write_card(folder, name)
        shutil.rmtree(PACKAGED / name, ignore_errors=True)
        shutil.copytree(folder, PACKAGED / name)
    record_actions(name)
    return PACKAGED / name


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", help="of the policy, as in policy=NAME")
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("--suite", type=Path, help="the folder that uavrl-evaluate suite=all wrote; RUN_FOLDER/suite")
    parser.add_argument("--checkpoint", help="file of a checkpoint; the newest of the run")
    parser.add_argument(
        "--guards", nargs="+", default=["none"], help="that it flies with by default; those of best: all"
    )
    args = parser.parse_args()
    torch.set_num_threads(1)
    suite = (args.suite or args.run / "suite") / "suite.json"
    folder = package(args.name, args.run, suite, args.checkpoint, args.guards)
    size = sum(file.stat().st_size for file in folder.iterdir())
    print(f"{folder}: {', '.join(sorted(file.name for file in folder.iterdir()))}; {size / 1e6:.1f} MB")


if __name__ == "__main__":
    with one_sentence():
        main()
