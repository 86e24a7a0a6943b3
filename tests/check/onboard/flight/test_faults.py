"""The most dangerous faults of the rehearsal, flown by ``uavrl-fly`` against ``uavrl-sitl``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.helpers.folders import ROOT
from tests.helpers.measured import measured
from tests.helpers.ports import free_ports

pytestmark = measured


@pytest.fixture
def flight(policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Flies a row of the table of faults; what came of it, and what `uavrl-fly` printed."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import faults

    def fly(name: str, unhurt: dict[str, Any] | None = None) -> tuple[dict[str, Any], str]:
        (fault,) = (each for each in faults.FAULTS if each.name == name)
        folder = tmp_path / name.replace(" ", "_")
        return faults.row(fault, policy, 3, folder, unhurt, free_ports()), (folder / "fly.log").read_text()

    return fly


def test_a_pose_that_jumps_to_the_goal_for_a_moment_is_no_arrival(flight: Any) -> None:
    unhurt, _ = flight("none")
    jumped, printed = flight("position at the goal for 0.3 s", unhurt)
    assert (jumped["verdict"], jumped["reason"], jumped["outcome"]) == ("holds", "position_jumped", "success"), printed
    assert jumped["zeros_after"] <= 0.25
    assert jumped["arrived_after_s"] > 10.0, "28 m of the way were left"
    assert "the position jumped by" in printed and "holding (position_jumped)" in printed


def test_half_of_a_scan_ends_the_flight(flight: Any) -> None:
    row, printed = flight("half of the scan cut off")
    assert (row["verdict"], row["reason"]) == ("ends", "half_scan"), printed
    assert row["zeros_after"] <= 2.5 and row["arrived_after_s"] is None and row["outcome"] != "collision"


def test_a_camera_never_replaces_the_vehicle(flight: Any) -> None:
    row, printed = flight("a camera's heartbeats")
    assert (row["verdict"], row["outcome"]) == ("goes on", "success"), printed


def test_a_signed_link_is_explained_and_flown_with_its_key(flight: Any) -> None:
    row, printed = flight("link signed, key unknown")
    assert (row["verdict"], row["outcome"]) == ("never begins", None), printed
    assert "PX4 signs its messages and ignores ours: give signing_key_file=" in printed
    row, printed = flight("link signed, key given")
    assert (row["verdict"], row["outcome"]) == ("goes on", "success"), printed
