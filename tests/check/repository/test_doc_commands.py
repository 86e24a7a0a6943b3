"""The commands that the documentation shows compose with today's keys, choices and ranges."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from tests.helpers.folders import ROOT
from uavrl.config import compose, validate
from uavrl.config.settings import EvaluateConfig
from uavrl_onboard.cli import check, fly, scan
from uavrl_onboard.cli.command import settings

YAML = {
    "train": "config",
    "evaluate": "evaluate",
    "replay": "replay",
    "pretrain": "pretrain",
    "report": "report",
    "export": "export",
    "sitl": "sitl",
}
ON_BOARD = {
    "scan": (scan.ABOUT, scan.ScanConfig),
    "check": (check.ABOUT, fly.FlyConfig),
    "fly": (fly.ABOUT, fly.FlyConfig),
}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page: Path) -> Iterator[str]:
    """The lines of a page's shell blocks that call uavrl, but for those that say at which commit they were typed."""
    for block in re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
        if re.search(r"git checkout|\bat [0-9a-f]{7}\b", block):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            yield from re.findall(rf"(?:^|&& )(?:PYTHONPATH=\S+ )?(uavrl-(?:{'|'.join([*YAML, *ON_BOARD])}) .*)", line)


NOT_OURS = ("my_conf", "<TAB>", " -sc ")  # the reader's own parts, and the shell's completion
SHOWN = [
    (page.relative_to(ROOT).as_posix(), line)
    for page in PAGES
    for line in commands(page)
    if not any(sign in line for sign in NOT_OURS)
]


@pytest.mark.parametrize(("page", "line"), SHOWN)
def test_a_command_of_the_docs_composes(page: str, line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "studies/lost_parts")
    if "my_parts" in line:  # the reader saves the page's class
        written = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL)
        (tmp_path / "my_parts.py").write_text("\n".join(written), encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "my_parts", raising=False)
    words = [word for word in shlex.split(line, comments=True) if word != "…"]
    own = [ROOT / after for word, after in pairwise(words) if word == "--config-dir"]
    command = words[0].removeprefix("uavrl-")
    if command in ON_BOARD:
        settings(*ON_BOARD[command], words[1:])
        return
    overrides = [word for word in words[1:] if word.startswith("~") or ("=" in word and not word.startswith("-"))]
    sweep = [word for word in overrides if OverridesParser.create().parse_override(word).is_sweep_override()]
    first = [word.partition(",")[0] if word in sweep else word for word in overrides]
    name = YAML[command]
    config = compose(*first, name=name, own=own)
    if name == "config" and config.resume is None:
        validate(config)
    elif name == "evaluate":
        validate(config, EvaluateConfig)


def test_the_docs_show_commands() -> None:
    assert len(SHOWN) > 50
