"""A short flight along a corridor, cycle by cycle, as a flight's loop would log it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from uavrl_onboard.autopilot.frames import Pose, to_goal
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log import FlightLog
from uavrl_onboard.flight.safety import Cycle, SafetyLayer
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.perception.reductions import range_image
from uavrl_onboard.policy.contract import Contract, read_contract

ROOT = Path(__file__).resolve().parents[2]
GOAL = (12.0, 1.0, 2.5)
WALLS = 3.0  # m from the corridor's middle, y = 0
START = 1000.0  # of the loop's clock, s
YAW, PITCH, ROLL = 0.3, 0.25, -0.15  # of the vehicle, rad
ATTITUDE = Rotation.from_euler(
    "ZYX", [YAW, PITCH, ROLL]
)  # in capitals: each turn about the axes that the last has left
SILENT = (30, 40)  # cycles without a scan: the sensor is silent
IN_CONTROL = VehicleStatus(Control.IN_CONTROL, "PX4 flies by set-points (OFFBOARD)", "PX4", "OFFBOARD", True)
DISARMED = VehicleStatus(Control.DISARMED, "PX4 is in OFFBOARD, and not armed", "PX4", "OFFBOARD", False)


@cache
def contract() -> Contract:
    return read_contract(ROOT / "uavrl/policies/data/best")


def corridor(position: np.ndarray, attitude: Rotation) -> np.ndarray:
    """What a sensor sees of two walls and the ground, ``float32 [P, 3]`` in its frame; misses are NaN."""
    rays = firing_directions().reshape(-1, 3)[::4]
    _, across, down = attitude.apply(rays).T
    with np.errstate(divide="ignore"):
        walls = np.maximum((WALLS - position[1]) / across, (-WALLS - position[1]) / across)
        ground = np.where(down < 0, -position[2] / down, np.inf)
    far = np.minimum(walls, ground)
    return np.where(far[:, None] < 30.0, rays * far[:, None], np.nan).astype(np.float32)


def cycles(count: int = 60) -> Iterator[FlightCycle]:
    """A flight of some cycles; for one second the sensor is silent, and before the third there is no pose."""
    layer, sensor = SafetyLayer(), np.array(contract().cloud.sensor_position)
    scanned = START
    for number in range(count):
        now = START + 0.1 * number
        place = np.array([0.2 * number, 0.05 * number - 1.0, 2.5])
        pose = Pose(now - 0.02, tuple(place.tolist()), (2.0, 0.5, 0.0), YAW, ROLL, PITCH) if number > 2 else None
        scan = None
        if not SILENT[0] <= number < SILENT[1]:
            points, scanned = corridor(place + ATTITUDE.apply(sensor), ATTITUDE), now - 0.01
            scan = Scan(scanned, points, len(points), int(np.isnan(points[:, 0]).sum()))
        action = np.array([1.0, 0.25, -0.125, 0.5 - 0.01 * number], np.float32)
        control = IN_CONTROL if number > 15 else DISARMED
        known = (None, None, None) if pose is None else (pose.stamp, pose.position, pose.yaw)
        yield FlightCycle(
            time=now,
            scan=scan,
            cells=None if scan is None else range_image(scan.points, 4.0),
            pose=pose,
            distance=None if pose is None else to_goal(pose, GOAL)["distance"],
            action=None if pose is None else action,
            control=control,
            status=layer.step(Cycle(now, action, scanned, *known, control.control is Control.IN_CONTROL)),
            latency=None if scan is None else 0.012,
            arrived=number >= 50,
            turn=None if scan is None else -0.01 * number,
        )


def write_log(path: Path, count: int = 60) -> tuple[Path, list[FlightCycle]]:
    """A log of such a flight, and its cycles."""
    flown = list(cycles(count))
    with FlightLog(path, contract(), GOAL, live=False, clock=lambda: START) as log:
        for cycle in flown:
            log.write(cycle)
    return log.path, flown
