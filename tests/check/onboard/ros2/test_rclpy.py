"""``uavrl-fly`` against real nodes of ROS 2 on Fast DDS, its default middleware, without any setting for DDS."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.folders import ROOT
from tests.helpers.measured import measured
from tests.helpers.ros2_peer import DOMAIN

ROS = "needs rclpy: pip install 'uavrl[dev]' on CPython 3.11, Linux on x86-64"
pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")
for module in ("rclpy", "sensor_msgs.msg", "nav_msgs.msg", "geometry_msgs.msg", "diagnostic_msgs.msg"):
    pytest.importorskip(module, reason=ROS)
pytest.importorskip("visualization_msgs.msg", reason=ROS)

pytestmark = measured

GOAL = (13.0, 0.0, 3.0)


def flown(policy: Path, keys: list[str], **options: Any) -> tuple[dict[str, Any], str]:
    """What the vehicle tells after a flight, and what ``uavrl-fly`` printed."""
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("CYCLONEDDS_", "ROS_", "RMW_"))
    }
    environment |= {"ROS_DOMAIN_ID": str(DOMAIN)}
    behaves = {"stamped": False, "reliable": False, "ring": False, "silent": (0, 0), "restart": 0, "simulated": None}
    told = json.dumps({**behaves, **options})
    vehicle = subprocess.Popen(
        [sys.executable, "-m", "tests.helpers.rclpy_vehicle", told],
        cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    command = [sys.executable, "-m", "uavrl_onboard.cli.fly", f"policy={policy}", "lidar=ros2:///points"]
    command += ["autopilot=ros2:///odom", f"goal={list(GOAL)}".replace(" ", ""), "log=null", "hold=0.5", "seconds=60"]
    try:
        ours = subprocess.run([*command, *keys], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=150)
        out, error = vehicle.communicate(timeout=90)
    finally:
        vehicle.kill()
    assert vehicle.returncode == 0, error
    assert ours.returncode == 0, ours.stderr
    return json.loads(out), ours.stdout + ours.stderr


def check_arrived(told: dict[str, Any], printed: str) -> None:
    assert "it arrived after" in printed, printed
    x, y, z = told["position"]
    assert math.hypot(x - GOAL[0], y - GOAL[1]) < 1.5 and z > 1.0
    assert told["nearest"] > 0.2 and told["heard"] > 20 and told["middleware"] == "rmw_fastrtps_cpp"


def test_twists_on_best_effort_and_a_lidar_that_falls_silent(policy: Path) -> None:
    reports = ["ros2.diagnostics=true", "ros2.markers=true"]
    told, printed = flown(policy, reports, silent=(2.0, 4.0))
    check_arrived(told, printed)
    assert "holding (old_scan)" in printed and "silent (old_scan)" in printed
    assert told["diagnostics"] == ["uavrl: flight", "uavrl: LiDAR", "uavrl: vehicle"]
    assert told["markers"][0] == "goal" and "set-point" in told["markers"]


def test_stamped_twists_reliable_clouds_with_rings_a_driver_that_starts_again_and_a_bag_s_clock(policy: Path) -> None:
    guards = ["ros2.kind=twist_stamped", "hull.radius=0.2", "guards=all"]
    told, printed = flown(policy, guards, stamped=True, reliable=True, ring=True, restart=2.0, simulated=8.0)
    check_arrived(told, printed)
    assert "The clock that stamps /odom has stepped back by" in printed
    assert "The clock that stamps /points has stepped back by" in printed
