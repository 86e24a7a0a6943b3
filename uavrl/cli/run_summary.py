"""``python -m uavrl.cli.run_summary RUN_FOLDER``: three lines about a run that was trained, evaluated and replayed."""

import json
import sys
from pathlib import Path
from typing import Any

from uavrl.cli.logs import configure_logging
from uavrl.config.command_line import command_line
from uavrl.errors import UavrlError, reason
from uavrl.runs.config import read_config
from uavrl.runs.names import SUMMARY
from uavrl_onboard.cli.process import command_process
from uavrl_onboard.pluralize import pluralize


def main() -> None:
    """Reads the files of the run folder that was named, of several evaluations the newest."""
    with command_process():
        configure_logging()
        print(reached(Path(sys.argv[1])))


def reached(folder: Path) -> str:
    """What was reached, where it is, and how to look at it."""
    evaluate = command_line("uavrl-evaluate", run=folder)
    evaluations = sorted(folder.glob("evaluation*.json"), key=lambda path: path.stat().st_mtime)
    if not evaluations:
        raise UavrlError(f"{folder} holds no evaluation: run {evaluate} first.")
    try:
        files = (folder / SUMMARY, evaluations[-1])
        summary, evaluation = (json.loads(path.read_text(encoding="utf-8")) for path in files)
        success = {name: f"{100 * share:.0f}" for name, share in evaluation["success"].items()}
        tasks = f"{pluralize(evaluation['episodes'], 'fixed task')} without noise{_unseen(folder, evaluation)}"
        more = f"{command_line('uavrl-evaluate', run=folder, suite='all')} evaluates it in every scenario"
        return (
            f"Reached: {success['rate']} % of {tasks} ({success['low']}-{success['high']} %), after "
            f"{pluralize(summary['episodes'], 'episode')}, {pluralize(summary['steps'], 'step')} and "
            f"{summary['minutes']:.1f} minutes.\n"
            f"Where:   {folder} ({more}, uavrl-export keeps the policy on its own)\n"
            f"Look:    open {folder / 'replay.html'} in a browser"
        )
    except (OSError, ValueError, KeyError) as error:
        raise UavrlError(f"Expected a run that has ended and was evaluated in {folder}: {reason(error)}.") from error


def _unseen(folder: Path, evaluation: dict[str, Any]) -> str:
    """Says of an evaluation that the run was not trained in any of its valleys."""
    world = read_config(folder).env.get("world")
    seen = world is None or set(evaluation["valleys"]) & set(world.seeds)
    return "" if seen else " in valleys that it never saw"


if __name__ == "__main__":
    main()
