"""``uavrl-check`` against a simulated vehicle by UDP, and against real nodes of ROS 2."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.folders import ROOT
from tests.helpers.measured import measured
from tests.helpers.ports import free_ports
from tests.helpers.ros2_peer import DOMAIN

pytestmark = measured


@contextmanager
def vehicle(folder: Path, lidar: int, autopilot: int) -> Iterator[dict[str, Any]]:
    """A simulated vehicle that hovers; what it tells of its task, and at the end of what it was sent."""
    where = [f"lidar=udp://127.0.0.1:{lidar}", f"autopilot=udp://127.0.0.1:{autopilot}", "patience=600"]
    command = [sys.executable, "-m", "uavrl.cli.sitl", "task=3", *where, "perception.lidar.max_range=20"]
    file, told = folder / "task.json", dict[str, Any]()
    begun = time.monotonic()
    with (folder / "sitl.log").open("w") as log:
        process = subprocess.Popen([*command, f"json={file}"], stdout=log, stderr=log, cwd=folder)
    try:
        while not file.exists():
            assert process.poll() is None and time.monotonic() - begun < 120, (folder / "sitl.log").read_text()
            time.sleep(0.1)
        told |= json.loads(file.read_text())
        yield told
        process.send_signal(signal.SIGINT)
        process.wait(30)
        told |= json.loads(file.read_text())
    finally:
        process.kill()
        process.wait()


def checked(policy: Path, folder: Path, *keys: str, **environment: str) -> tuple[int, dict[str, str], str]:
    """The exit code of a check, the level of each item, and what was printed."""
    command = [sys.executable, "-m", "uavrl_onboard.cli.check", f"policy={policy}", "model=VLP16", *keys]
    file = folder / "check.json"
    done = subprocess.run(
        [*command, f"json={file}", f"log={folder / 'flight.mcap'}"],
        capture_output=True, text=True, cwd=folder, env={**os.environ, **environment}, timeout=120,
    )  # fmt: skip
    told = json.loads(file.read_text())
    assert told["passed"] is (done.returncode == 0)
    return done.returncode, {item["name"]: item["level"] for item in told["items"]}, done.stdout + done.stderr


def test_a_vehicle_that_is_ready_and_one_whose_lidar_is_silent(policy: Path, tmp_path: Path) -> None:
    (lidar, autopilot), (silent, _) = free_ports(), free_ports()
    with vehicle(tmp_path, lidar, autopilot) as told:
        goal = f"goal={told['goal']}".replace(" ", "")
        link = f"autopilot=udp://127.0.0.1:{autopilot}"
        code, levels, printed = checked(policy, tmp_path, goal, link, f"lidar=udp://127.0.0.1:{lidar}", "set_mode=true")
        assert code == 0, printed
        assert set(levels.values()) == {"pass"} and len(levels) == 17 and "17 pass: all is there." in printed
        assert "The vehicle is system 1, component 1." in printed and "PX4 is in AUTO.LOITER" in printed
        code, levels, printed = checked(policy, tmp_path, goal, link, f"lidar=udp://127.0.0.1:{silent}")
        assert code == 1 and "do not take off" in printed, printed
        assert {name for name, level in levels.items() if level == "fail"} == {"scans", "guards", "latency"}
        assert "No scan has come in 6 s: no packet arrived. Set this computer's address" in printed
    assert told["setpoints"] == 0 and [mode for _, mode, _ in told["modes"]] == ["AUTO.LOITER"], "nothing was sent"
    assert not (tmp_path / "flight.mcap").exists()


def test_nodes_of_ros2(policy: Path, tmp_path: Path) -> None:
    pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'uavrl[dev]' on CPython 3.11, Linux on x86-64")
    told = {"stamped": False, "reliable": False, "ring": False, "silent": (0, 0), "restart": 0, "simulated": None}
    domain = {"ROS_DOMAIN_ID": str(DOMAIN)}
    command = [sys.executable, "-m", "tests.helpers.rclpy_vehicle", json.dumps(told)]
    process = subprocess.Popen(command, cwd=ROOT, env={**os.environ, **domain}, stdout=subprocess.DEVNULL)
    where = ("lidar=ros2:///points", "autopilot=ros2:///odom", "goal=[13,0,3]")
    try:
        code, levels, printed = checked(policy, tmp_path, *where, **domain)
        assert code == 0 and set(levels.values()) == {"pass"}, printed
        assert "/cmd_vel has 1 subscriber, which may obey it" in printed
        code, levels, printed = checked(policy, tmp_path, *where, "guards=[map]", **domain)
        assert code == 2 and {name for name, level in levels.items() if level != "pass"} == {"guards"}, printed
        assert "Velocity and roll and pitch are exactly 0 in each pose" in printed
    finally:
        process.kill()
        process.wait()


def test_a_policy_that_is_damaged(policy: Path, tmp_path: Path) -> None:
    for file in policy.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    with (tmp_path / "policy.onnx").open("ab") as file:
        file.write(b"\0")
    code, levels, printed = checked(tmp_path, tmp_path, "goal=[13,0,3]")
    assert (code, levels) == (1, {"policy": "fail"}) and "1 fail: do not take off." in printed
