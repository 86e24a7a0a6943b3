"""Settings of ``uavrl-report``. Meanings stand in the yaml."""

from dataclasses import dataclass
from pathlib import Path

from uavrl.configs.checks import require
from uavrl.ranges import Count, Folder, Share


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
        require(
            self.facts.resolve() != Path(self.output).resolve(), "json", "another file than output", str(self.facts)
        )

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
