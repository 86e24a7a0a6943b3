"""``uavrl-report``: one page and one JSON file about any number of runs."""

import argparse
import sys
from collections.abc import Sized
from pathlib import Path

from uavrl.cli.process import command_process
from uavrl.errors import UavrlError
from uavrl.runs.files import replacing, writable


def main() -> None:
    """Reads run folders, writes the report and says what it left out."""
    parser = argparse.ArgumentParser(
        prog="uavrl-report",
        description="Writes one HTML page and one JSON file of the same facts about runs.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="RUN_FOLDER", help="a run, or a folder with runs in it"
    )
    parser.add_argument("--output", type=Path, default=Path("report.html"), help="the page (default: report.html)")
    parser.add_argument("--json", type=Path, default=None, help="the facts (default: beside the page, ending in .json)")
    parser.add_argument("--window", type=int, default=500, help="episodes that a rate covers (default: 500)")
    parser.add_argument("--threshold", type=float, default=0.78, help="success rate to be reached (default: 0.78)")
    parser.add_argument("--title", default=None, help="of the page")
    with command_process():
        _report(parser.parse_args())


def _report(args: argparse.Namespace) -> None:
    # Imported here: --help answers without loading anything.
    from uavrl.reporting.page import page
    from uavrl.reporting.report import make_report

    writable(args.output, "--output FILE")
    facts = args.json or args.output.with_suffix(".json")
    if facts.resolve() == args.output.resolve():
        raise UavrlError(f"Page and facts cannot both go to {facts}: name another file with --json.")
    writable(facts, "--json FILE")
    report = make_report(args.folders, window=args.window, threshold=args.threshold, title=args.title)
    for warning in report.warnings():
        print(f"uavrl: {warning}", file=sys.stderr)
    for path, text in {args.output: page(report), facts: report.to_json()}.items():
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    groups = ", ".join(f"{group['label']} ({len(group['seeds'])})" for group in report.groups)
    print(f"{_count(report.runs, 'run')} in {_count(report.groups, 'group')} (seeds): {groups}")
    best = report.groups[0]
    success = best["last"]["success"]
    rate, low, high = (f"{100 * success[name]:.1f}" for name in ("rate", "low", "high"))
    print(
        f"Best: {best['label']}, {rate} % of the last flights arrived ({low}-{high} %). "
        f"Open {args.output} in a browser; {facts} holds the facts."
    )


def _count(things: Sized, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


if __name__ == "__main__":
    main()
