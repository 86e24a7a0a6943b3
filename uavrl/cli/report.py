"""``uavrl-report``: one page and one JSON file about any number of runs."""

import argparse
import errno
import sys
from collections.abc import Sized
from pathlib import Path

from uavrl.cli.errors import one_sentence
from uavrl.errors import UavrlError


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
    parser.add_argument(
        "--cdn",
        action="store_true",
        help="fetch plotly when the page is opened instead of carrying it: needs a network, saves 5 MB",
    )
    with one_sentence():
        _report(parser.parse_args())


def _report(args: argparse.Namespace) -> None:
    # Imported here: --help answers without loading anything.
    from uavrl.reporting.page import page
    from uavrl.reporting.report import make_report

    for option, path in (("--output", args.output), ("--json", args.json)):
        if path is not None and (not path.name or path.is_dir()):
            raise UavrlError(f"{path} cannot be written (it is a folder): name a file with {option}.")
    facts = args.json or args.output.with_suffix(".json")
    if facts.resolve() == args.output.resolve():
        raise UavrlError(f"Page and facts cannot both go to {facts}: name another file with --json.")
    report = make_report(args.folders, window=args.window, threshold=args.threshold, title=args.title)
    for warning in report.warnings():
        print(f"uavrl: {warning}", file=sys.stderr)
    _write({args.output: page(report, cdn=args.cdn), facts: report.to_json()})
    groups = ", ".join(f"{group['label']} ({len(group['seeds'])})" for group in report.groups)
    print(f"{_count(report.runs, 'run')} in {_count(report.groups, 'group')} (seeds): {groups}")
    print(f"Written to {args.output} and {facts}")


def _count(things: Sized, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _write(texts: dict[Path, str]) -> None:
    """Writes all files or none."""
    partials = {path: path.with_name(f"{path.name}.partial") for path in texts}
    try:
        for path, text in texts.items():
            try:
                if path.is_dir():
                    raise IsADirectoryError(errno.EISDIR, "it is a folder")
                path.parent.mkdir(parents=True, exist_ok=True)
                partials[path].write_text(text, encoding="utf-8")
            except OSError as error:
                raise UavrlError(f"{path} cannot be written ({error.strerror}): choose another file.") from error
        for path, partial in partials.items():
            partial.replace(path)
    finally:
        for partial in partials.values():
            if partial.parent.is_dir():
                partial.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
