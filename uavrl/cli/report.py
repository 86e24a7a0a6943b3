"""``uavrl-report``: one page and one JSON file about any number of runs."""

import sys
from collections.abc import Sized
from pathlib import Path

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.configs import checked
from uavrl.configs.report import ReportConfig
from uavrl.runs.files import replacing, writable


@command("report")
def main(config: DictConfig) -> None:
    """Reads run folders, writes the report and says what it left out."""
    _report(checked(config, ReportConfig))


def _report(settings: ReportConfig) -> None:
    # Imported here: --help and a mistyped key answer without loading anything.
    from uavrl.reporting.page import page
    from uavrl.reporting.report import make_report

    output, facts = writable(Path(settings.output)), writable(settings.facts, "json=FILE")
    report = make_report(settings.folders, window=settings.window, threshold=settings.threshold, title=settings.title)
    for warning in report.warnings():
        print(f"uavrl: {warning}", file=sys.stderr)
    for path, text in {output: page(report), facts: report.to_json()}.items():
        with replacing(path) as partial:
            partial.write_text(text, encoding="utf-8")
    groups = ", ".join(f"{group['label']} ({len(group['seeds'])})" for group in report.groups)
    print(f"{_count(report.runs, 'run')} in {_count(report.groups, 'group')} (seeds): {groups}")
    best = report.groups[0]
    success = best["last"]["success"]
    rate, low, high = (f"{100 * success[name]:.1f}" for name in ("rate", "low", "high"))
    print(
        f"Best: {best['label']}, success rate {rate} % over the last episodes ({low}-{high} %). "
        f"Open {output} in a browser; {facts} holds the facts."
    )


def _count(things: Sized, name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


if __name__ == "__main__":
    main()
