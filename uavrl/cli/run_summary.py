"""``python -m uavrl.cli.run_summary RUN_FOLDER``: three lines about a run that was trained, evaluated and replayed."""

import json
import sys
from pathlib import Path

from uavrl.cli.errors import configure_logging
from uavrl.cli.process import command_process
from uavrl.command_line import command_line
from uavrl.errors import UavrlError
from uavrl.runs.names import SUMMARY


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
        summary, evaluation = (
            json.loads(path.read_text(encoding="utf-8")) for path in (folder / SUMMARY, evaluations[-1])
        )
        success = {name: f"{100 * share:.0f}" for name, share in evaluation["success"].items()}
        again = f"{evaluate} flies it again, uavrl-export keeps the policy on its own"
        return (
            f"Reached: {success['rate']} % of fixed tasks without noise ({success['low']}-{success['high']} %), after "
            f"{summary['episodes']} flights, {summary['steps']:,} steps and {summary['minutes']:.1f} minutes.\n"
            f"Where:   {folder} ({again})\n"
            f"Look:    open {folder / 'replay.html'} in a browser"
        )
    except (OSError, ValueError, KeyError) as error:
        raise UavrlError(f"Expected a run that has ended and was evaluated in {folder}: {error}.") from error


if __name__ == "__main__":
    main()
