"""Links in a run folder matter where something is read or written through them, and there alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from uavrl.errors import UavrlError
from uavrl.runs.names import TRAINING
from uavrl.runs.trust import check_links


def linked(run: Path, name: str, target: Path) -> None:
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / name).symlink_to(target)


@pytest.mark.parametrize(
    "name",
    ["notes.txt", "config.yaml.partial", "logs/wandb/debug.log", "logs/wandb/offline-run-1/logs/debug-core.log"],
)
def test_what_nothing_follows_may_lead_anywhere(name: str, tmp_path: Path) -> None:
    linked(tmp_path / "run", name, tmp_path / "elsewhere.log")
    check_links(tmp_path / "run", TRAINING)


@pytest.mark.parametrize("name", [*TRAINING, "checkpoints/a", "logs/run/scalars/a.csv", "logs/wandb", "logs/a.log"])
def test_what_is_written_may_not(name: str, tmp_path: Path) -> None:
    linked(tmp_path / "run", name, tmp_path / "not yet there")
    with pytest.raises(UavrlError, match=rf"/{name} is a link that leads out of .*/run: .* move all of"):
        check_links(tmp_path / "run", TRAINING)


@pytest.mark.parametrize(("name", "target"), [("logs/wandb/debug.log", "mine"), ("config.yaml", "run/config.yaml")])
def test_a_folder_among_wandb_s_links_and_a_link_to_itself_may_not(name: str, target: str, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    linked(tmp_path / "run", name, tmp_path / target)
    with pytest.raises(UavrlError, match="leads out of"):
        check_links(tmp_path / "run", TRAINING)


def test_links_within_and_the_folder_as_a_link_are_fine(tmp_path: Path) -> None:
    (tmp_path / "run/checkpoints").mkdir(parents=True)
    linked(tmp_path / "run", "logs/latest", tmp_path / "run/checkpoints")
    (tmp_path / "other").symlink_to(tmp_path / "run")
    check_links(tmp_path / "other", TRAINING)
