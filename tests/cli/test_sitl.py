"""``uavrl-sitl``: what a user may get wrong, and what stands in its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.autopilot_peer import free_port
from tests.helpers.commands import VALLEY, in_process
from uavrl.cli import sitl
from uavrl.sitl.sitl import Result


@pytest.mark.parametrize(
    ("argument", "says"),
    [
        ("speed=fast", "speed must be a number or one of lockstep"),
        (
            "lidar=udp://:2368",
            "lidar must be udp://HOST:PORT, where to send to, such as udp://127.0.0.1:2368, or ros2:///TOPIC",
        ),
        (
            "autopilot=tcp://127.0.0.1:1",
            "autopilot must be udp://HOST:PORT, where to send to, such as udp://127.0.0.1:14540",
        ),
        ("lidar=127.0.0.1:2368", "lidar must be udp://HOST:PORT"),
        ("lidar=udp://127.0.0.1:99999", "lidar must be udp://HOST:PORT"),
        ("perception=none", "perception must be one that reads a LiDAR, such as truncated_icosahedron: "),
        ("env.lidar=mid360", "the LiDAR mid360 has none: publish its point clouds with lidar=ros2:///points"),
        ("lidar=ros2://points", "An address is ros2:///TOPIC or ros2://DOMAIN/TOPIC"),
        ("lidar=ros2:///points autopilot=ros2:///odom", "autopilot must be udp://HOST:PORT, where to send to, such as"),
        ("env.num_uavs=3", "env.num_uavs is set by the command itself"),
        ("pilot_takes_over=-1", "pilot_takes_over must be at least 0"),
        ("faults.lidar_silent=[3,1]", "faults.lidar_silent must be two times in s from 0, the earlier first"),
        ("faults.pose_silent=[-1,1]", "faults.pose_silent must be two times in s from 0, the earlier first"),
        ("faults.seed=-1", "faults.seed must be a whole number from 0, got -1"),
        ("faults.lose=2", "faults.lose must be a share"),
        ("task=-1", "task must be at least 0"),
        ("firmware=betaflight", "firmware must be one of px4, ardupilot"),
    ],
)
def test_mistakes_are_told_in_a_sentence(argument: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(sitl.main, *argument.split()) == 1
    out, err = capsys.readouterr()
    (told,) = [line for line in err.splitlines() if line != "Loading the simulator ..."]
    assert says in told and out == ""


def test_what_was_stopped_is_told_once() -> None:
    assert sitl._stopped(Result()) == "stopped: No set-point was obeyed."
    flown = Result(seconds=4.8, distance=23.94, least_distance=20.0, setpoints=48)
    assert sitl._stopped(flown) == "stopped after 4.8 s, 23.9 m from the goal (nearest 20.0 m)."


def test_a_task_without_a_companion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = tmp_path / "task.json"
    addresses = [f"lidar=udp://127.0.0.1:{free_port()}", f"autopilot=udp://127.0.0.1:{free_port()}"]
    assert in_process(sitl.main, *VALLEY, *addresses, "valleys=[3,4]", "task=2", "patience=0.2", f"json={told}") == 1
    out, err = capsys.readouterr()
    task = json.loads(told.read_text())
    assert f"Task 2 in valley {task['valley']}: from (" in out and task["valley"] in (3, 4)
    goal = ",".join(f"{each:g}" for each in task["goal"])
    assert f"goal=[{goal}], {task['distance_at_start']:.1f} m." in out
    assert "the vehicle is in AUTO.LOITER; set-points are obeyed in OFFBOARD." in err  # and perhaps its slowness
    assert (task["outcome"], task["setpoints"], task["start"][2]) == ("stopped", 0, 3.5)
    assert abs(task["goal"][0]) <= 7.0 and abs(task["goal"][1]) <= 6.0 and task["least_distance"] is None
