"""Our side of ROS 2 in a process of its own: it answers each scan with one set-point, and tells what it saw."""

from __future__ import annotations

import json
import select
import sys
import time

import numpy as np

from uavrl_onboard.geometry import is_return
from uavrl_onboard.ros2.px4 import Px4Ros2
from uavrl_onboard.ros2.vehicle import Ros2Scans, Ros2Vehicle

SETPOINT = (1.0, 0.5, -0.25, 1.25)


def main(kind: str, domain: str, scans: int) -> None:
    """Answers so many scans, then ends."""
    link = Px4Ros2(f"ros2://{domain}/fmu") if kind == "px4" else Ros2Vehicle(f"ros2://{domain}/odom")
    with Ros2Scans(f"ros2://{domain}/velodyne_points") as feed, link:
        seen = 0
        while seen < scans:
            select.select([feed.fileno(), link.fileno()], [], [], 0.1)
            now = time.monotonic()
            link.receive(now)
            scan, pose = feed.poll(now), link.pose()
            if scan is None or pose is None:
                continue
            link.send(SETPOINT, now)
            seen += 1
            points = scan.points[is_return(scan.points)]
            told = {
                "points": len(points),
                "nearest": float(np.sqrt((points**2).sum(-1)).min()),
                "scan_age": now - scan.stamp,
                "position": pose.position,
                "yaw": pose.yaw,
                "pose_age": now - pose.stamp,
                "control": link.status(now).control,
            }
            sys.stdout.write(json.dumps(told) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
