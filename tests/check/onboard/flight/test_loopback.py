"""``uavrl-sitl`` and ``uavrl-fly`` in two processes over loopback UDP: the whole chain, and what goes wrong in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.helpers.folders import ROOT
from tests.helpers.measured import measured
from tests.helpers.ports import free_ports
from tests.helpers.ros2_peer import DOMAIN, LOOPBACK

pytestmark = measured


@pytest.fixture
def flight(policy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Flies a task; what `uavrl-sitl` told, what `uavrl-fly` told, and what the latter printed."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    from loopback import flown

    def fly(task: int, *sitl: str, fly: tuple[str, ...] = ()) -> tuple[dict[str, Any], dict[str, Any], str]:
        folder = tmp_path / str(task)
        vehicle, told = flown(policy, task, folder, sitl, fly, free_ports())
        return vehicle, told, (folder / "fly.log").read_text()

    return fly


def states(told: dict[str, Any]) -> list[tuple[str, str]]:
    return [(state, reason) for _, state, reason, _ in told["changes"]]


@pytest.mark.parametrize(("task", "firmware"), [(0, "px4"), (1, "ardupilot"), (2, "px4")])
def test_it_flies_to_the_goal(flight: Any, task: int, firmware: str) -> None:
    vehicle, told, printed = flight(task, f"firmware={firmware}", "perception.lidar.max_range=10")
    assert vehicle["outcome"] == "success" and told["arrived"], printed
    assert vehicle["modes"][1][1] == ("OFFBOARD" if firmware == "px4" else "GUIDED")
    assert told["least_distance_m"] <= 1.0
    assert ("flying", "in_control") in states(told)
    assert told["latency_ms"]["median"] < 40.0, "it may be slow on a busy machine, not as slow as half a scan"


def test_another_lidar_by_ros2(flight: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    lidar = f"lidar=ros2://{DOMAIN}/points"
    sensor = (lidar, "hull.elevations=[-7,52]", "hull.repeats=false")
    vehicle, told, printed = flight(0, "env.lidar=mid360", lidar, "perception.lidar.max_range=10", fly=sensor)
    assert vehicle["outcome"] == "success" and told["arrived"], printed
    assert told["latency_ms"]["median"] < 40.0


@pytest.mark.parametrize("name", ["vlp16", "mid360"])
def test_a_lidar_that_hangs_upside_down(flight: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    by_ros = name != "vlp16"  # which sends packets
    lidar = (f"lidar=ros2://{DOMAIN}/points",) if by_ros else ()
    sensor = ("mount=[180,0,90]", *(("hull.elevations=[-52,7]", "hull.repeats=false", *lidar) if by_ros else ()))
    hung = f"env.lidar={{name:hung,like:{name},mount:[180,0,90]}}"
    vehicle, told, printed = flight(1, hung, "perception.lidar.max_range=10", *lidar, fly=sensor)
    assert vehicle["outcome"] == "success" and told["arrived"], printed


def test_a_tenth_of_the_packets_is_lost_and_a_tenth_comes_late(flight: Any) -> None:
    vehicle, told, printed = flight(3, "faults.lose=0.1", "faults.reorder=0.1", "perception.lidar.max_range=10")
    assert vehicle["outcome"] == "success" and told["arrived"], printed


def test_the_lidar_is_silent_for_a_moment(flight: Any) -> None:
    vehicle, told, printed = flight(4, "faults.lidar_silent=[2,2.4]", "perception.lidar.max_range=10")
    after = states(told)[states(told).index(("flying", "in_control")) :]
    assert ("holding", "old_scan") in after, printed
    held = after.index(("holding", "old_scan"))
    assert ("flying", "in_control") in after[held:] and vehicle["modes"][-1][1] == "OFFBOARD", "it goes on"


def test_the_lidar_falls_silent_for_ever(flight: Any) -> None:
    vehicle, told, printed = flight(5, "faults.lidar_silent=[2,100]", "patience=10", fly=("seconds=14",))
    ended = states(told)
    assert ended[-1] == ("silent", "old_scan") and ("holding", "old_scan") in ended, printed
    assert not told["arrived"] and [mode for _, mode, _ in vehicle["modes"]][-1] == "AUTO.LOITER", "the stream ended"


def test_the_pose_is_missing_for_a_moment(flight: Any) -> None:
    _, told, printed = flight(6, "faults.pose_silent=[2,2.3]", "perception.lidar.max_range=10")
    after = states(told)[states(told).index(("flying", "in_control")) :]
    assert ("holding", "old_pose") in after, printed
    assert ("flying", "in_control") in after[after.index(("holding", "old_pose")) :]


def test_the_pilot_takes_over(flight: Any) -> None:
    vehicle, told, printed = flight(7, "pilot_takes_over=2", "perception.lidar.max_range=10", fly=("seconds=10",))
    assert states(told)[-1] == ("standby", "not_in_control"), printed
    assert [mode for _, mode, _ in vehicle["modes"]] == ["AUTO.LOITER", "OFFBOARD", "POSCTL"], "and it is never retaken"


def test_another_sensor_is_named(flight: Any) -> None:
    vehicle, told, printed = flight(8, "faults.product=33", "patience=8", fly=("seconds=6",))
    assert states(told) == [("silent", "no_scan")] and told["scans"] == 0
    assert "its packets carry the product byte 33 (0x21), and a VLP16 has 34" in printed
    assert vehicle["setpoints"] == 0 and vehicle["modes"][-1][1] == "AUTO.LOITER"
