"""``uavrl-report``: one page and one JSON file about any number of runs."""

import sys
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig

from uavrl.cli.command import command
from uavrl.config import validate
from uavrl.runs.episodes import success_text
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.ranges import Count, Folder, Share
from uavrl_onboard.sentences import require


@dataclass
class ReportConfig:
    """conf/report.yaml: one report."""

    runs: Folder | tuple[Folder, ...]
    output: Folder = "report.html"
    json: Folder | None = None
    window: Count = 500
    threshold: Share = 0.78
    title: str | None = None

    def __post_init__(self) -> None:
        """Checks that page and facts are two files."""
        apart = self.facts.resolve() != Path(self.output).resolve()
        require(apart, "json", "another file than output", str(self.facts))

    @property
    def facts(self) -> Path:
        """The file of the facts."""
        page = Path(self.output)
        return Path(self.json) if self.json else page.parent / f"{page.stem}.json"

    @property
    def folders(self) -> list[Path]:
        """The folders that are named; a pattern names all that fit it, or itself where none does."""
        named = (self.runs,) if isinstance(self.runs, str) else self.runs
        return [folder for name in named for folder in _matching(name)]


def _matching(name: str) -> list[Path]:
    path = Path(name)
    if path.exists() or not any(sign in name for sign in "*?"):
        return [path]
    return sorted(Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))) or [path]


@command("report")
def main(config: DictConfig) -> None:
    """Reads run folders, writes the report and says what it left out."""
    settings = validate(config, ReportConfig)
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
    print(f"{pluralize(len(report.runs), 'run')} in {pluralize(len(report.groups), 'group')} (seeds): {groups}")
    where, unit, rows = report.rates()
    print(f"In {where}:")
    print("\n".join(f"  {label}  {success_text(rate, number, unit)}" for label, rate, number in rows))
    if missing := [group["label"] for group in report.groups if group["label"] not in {row[0] for row in rows}]:
        print(f"  Not evaluated there: {'; '.join(missing)}")
    print(f"{report.verdict()} Open {output} in a browser; {facts} holds the facts.".lstrip())


if __name__ == "__main__":
    main()
