"""``python -m uavrl.cli.run_summary RUN_FOLDER``: some lines about a run that was trained, evaluated and replayed."""

import json
import sys
from pathlib import Path

from uavrl.cli.logs import configure_logging
from uavrl.config.command_line import command_line
from uavrl.errors import UavrlError, reason
from uavrl.evaluation.worlds import worlds_text
from uavrl.runs.config import read_config
from uavrl.runs.episodes import success_text
from uavrl.runs.labels import label
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
        success = success_text(evaluation["success"], evaluation["episodes"])
        config = read_config(folder)
        if (world := config.env.get("world")) is not None:
            evaluation = {"training_valleys": list(world.seeds), **evaluation}
        more = f"{command_line('uavrl-evaluate', run=folder, suite='all')} evaluates it in every scenario"
        return (
            f"{success}\n"
            f"Worlds:  {worlds_text(evaluation)}, without exploration noise\n"
            f"Policy:  {label(config.choices)}, trained for {pluralize(summary['episodes'], 'episode')}, "
            f"{pluralize(summary['steps'], 'step')} and {summary['minutes']:.1f} minutes\n"
            f"Where:   {folder} ({more}, uavrl-export keeps the policy on its own)\n"
            f"Look:    open {folder / 'replay.html'} in a browser"
        )
    except (OSError, ValueError, KeyError) as error:
        raise UavrlError(f"Expected a run that has ended and was evaluated in {folder}: {reason(error)}.") from error


if __name__ == "__main__":
    main()
