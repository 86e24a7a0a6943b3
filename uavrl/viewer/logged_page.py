"""The flight page of a real flight, from its log: what its scans have seen is the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from uavrl.errors import UavrlError
from uavrl.evaluation.recording import thinned
from uavrl.viewer.colours import STATES
from uavrl.viewer.flight_page import POINT_BYTES, drawn_parts, packed_points
from uavrl_onboard.autopilot.frames import Vector
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.logged_flight import FARTHEST, LoggedFlight
from uavrl_onboard.geometry import is_return
from uavrl_onboard.pages.assembly import pack
from uavrl_onboard.pages.shapes import shell
from uavrl_onboard.perception.reductions import directions
from uavrl_onboard.pluralize import pluralize

MOST_CYCLES = 36_000  # an hour
MOST_POINTS = 1_000_000  # of all scans that are kept: where there are more, each scan keeps half as many
WORLD_POINTS = 40_000
VOXEL = 0.15  # m: of the points in such a cube one is drawn
NEAR = 8.0  # m: what is seen farther away is drawn in its moment alone, since it moves and turns during a scan
FRESH = 0.2  # s: for so long a scan is shown where none has come since; so long the policy flies by it


class LoggedMoments:
    """The moments of a log that have a pose, and what the scans saw of the world.

    Args:
        flight: the log.
        points: how many of each scan are kept, at most.
    """

    def __init__(self, flight: LoggedFlight, points: int) -> None:
        self.flight, self._most, self._kept = flight, points, 0
        self.cycles: list[FlightCycle] = []  # their scans are in the lists below
        self.positions: list[Vector] = []
        self.attitudes: list[Sequence[float]] = []  # x, y, z, w
        self.clouds: list[np.ndarray] = []
        self.cells: list[np.ndarray] = []
        self.nearest: list[float] = []
        self.turns: list[float] = []  # off the goal's direction, rad
        self._world = [np.zeros((0, 3))]
        for cycle in flight:
            self._add(cycle)
            if len(self.cycles) > MOST_CYCLES:
                too_many = f"more than {MOST_CYCLES:,} cycles, too many for a page"
                raise UavrlError(f"{flight.path} holds {too_many}: open it in Foxglove.")
        if not self.cycles:
            raise UavrlError(f"{flight.path} holds no cycle with a pose: there is no flight to show.")

    def _add(self, cycle: FlightCycle) -> None:
        pose = cycle.pose
        if pose is not None and np.isfinite(pose.yaw) and (np.abs(pose.position) < FARTHEST).all():
            position, (w, *axis) = pose.position, pose.rotation
            attitude: Sequence[float] = (*axis, w)
        elif self.cycles:
            position, attitude = self.positions[-1], self.attitudes[-1]
        else:
            return  # nobody knows yet where it is
        cloud, age = np.zeros((0, 3), np.float32), cycle.status.scan_age
        cells, nearest = np.zeros(self.flight.contract.cells.count, np.float32), np.nan
        turn = cycle.turn or 0.0
        if cycle.scan is not None:
            returns = cycle.scan.points[is_return(cycle.scan.points)]
            far = np.linalg.norm(returns, axis=1)
            cloud, nearest = thinned(returns, self._most), float(far.min()) if len(far) else np.nan
            cells = cells if cycle.cells is None else cycle.cells
            self._see(thinned(returns[far < NEAR], 1500), position, attitude)
        elif self.clouds and age is not None and age <= FRESH:
            cloud, cells, nearest, turn = self.clouds[-1], self.cells[-1], self.nearest[-1], self.turns[-1]
        self.cycles.append(replace(cycle, scan=None, cells=None))
        self.positions.append(position)
        self.attitudes.append(attitude)
        self.clouds.append(cloud)
        self.cells.append(cells)
        self.nearest.append(nearest)
        self.turns.append(turn)
        self._kept += len(cloud)
        if self._kept > MOST_POINTS and self._most > 20:
            self._most //= 2
            self.clouds = [thinned(each, self._most) for each in self.clouds]
            self._kept = sum(map(len, self.clouds))

    def _see(self, points: np.ndarray, position: Vector, attitude: Sequence[float]) -> None:
        """Puts points of the sensor's frame into the world."""
        seen = Rotation.from_quat(attitude).apply(points + np.array(self.flight.sensor_position))
        self._world.append(seen + position)
        if len(self._world) > 200:
            self._world = [one_a_voxel(np.concatenate(self._world))]

    def world(self) -> np.ndarray:
        """What all scans have seen near the vehicle, ``[P, 3]`` in the world's axes in m."""
        return thinned(one_a_voxel(np.concatenate(self._world)), WORLD_POINTS)


def one_a_voxel(points: np.ndarray) -> np.ndarray:
    """The first of the points ``[P, 3]`` in each cube of space.

    Examples:
        >>> one_a_voxel(np.array([[0.01, 0.0, 0.0], [0.02, 0.0, 0.0], [1.0, 0.0, 0.0]])).tolist()
        [[0.01, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    _, first = np.unique(np.floor(points / VOXEL).astype(np.int32), axis=0, return_index=True)
    return points[np.sort(first)]


def logged_page_data(flight: LoggedFlight, points: int = 1500) -> dict[str, Any]:
    """The content of the page, as JSON."""
    moments = LoggedMoments(flight, points)
    cells, world = flight.contract.cells, moments.world()
    radius, height = flight.radius, max(2.0 * flight.goal[2], 1.0)  # its z is the middle of its height
    below = [(*flight.goal[:2], 0.0)]  # where the grid at z = 0 lies
    reach = np.concatenate([moments.positions, [flight.goal], below, world])
    low, high = reach.min(0) - 1.0, reach.max(0) + 1.0
    place = {
        "world": pack(world),
        "box": [[float(a), float(b)] for a, b in zip(low, high, strict=True)],
        "ball": cells.radius,
        "statistic": cells.statistic,
        "sensor": pack(np.array(flight.sensor_position)),
        "goal": pack(np.array([radius, height])),
    }
    return {
        **drawn_parts(shell(directions(cells.reduction, **cells.options), cells.radius)),
        "source": {"log": flight.path.name, "started": flight.about.get("started", "")},
        "states": STATES,
        "sceneries": {"log": place},
        "flights": [_flight(moments)],
    }


def _flight(moments: LoggedMoments) -> dict[str, Any]:
    flight, cycles, count = moments.flight, moments.cycles, len(moments.cycles)
    told = [[c.status.state, c.status.reason, c.status.sentence, c.control.sentence] for c in cycles]
    different = list(dict.fromkeys(map(tuple, told)))
    index = {each: number for number, each in enumerate(different)}
    arrays = {
        "times": np.array([cycle.time - cycles[0].time for cycle in cycles]),
        "positions": np.array(moments.positions),
        "attitudes": np.array(moments.attitudes),
        "velocities": np.array([np.full(3, np.nan) if c.pose is None else c.pose.velocity for c in cycles]),
        "goal": np.array(flight.goal),
        "distances": np.array([np.nan if c.distance is None else c.distance for c in cycles]),
        "actions": _fours([c.action for c in cycles]),
        "setpoints": _fours([c.status.setpoint for c in cycles]),
        "nearest": np.array(moments.nearest),
        "faces": np.stack(moments.cells),
        "told_at": np.array([index[tuple(each)] for each in told]),
    }
    if any(cycle.turn is not None for cycle in cycles):
        arrays["bearings"] = _bearings(moments)
    return {
        **{name: pack(values) for name, values in arrays.items()},
        **packed_points(moments.clouds, max(POINT_BYTES // (6 * count), 20)),
        "told": different,
        "world_seed": "log",
        "outcome": "arrived" if cycles[-1].arrived else "ended",
        "steps": count - 1,
        "facts": facts(moments),
        "notes": _missing(flight),
    }


def _bearings(moments: LoggedMoments) -> np.ndarray:
    """Where a memory led, from east to the left in rad; straight to the goal without a scan to fly by."""
    x, y = (np.array(moments.flight.goal[:2]) - np.array(moments.positions)[:, :2]).T
    return np.arctan2(y, x) + np.array(moments.turns)


def facts(moments: LoggedMoments) -> dict[str, str]:
    """What a flight came to, for people."""
    cycles, way = moments.cycles, np.diff(np.array(moments.positions), axis=0)
    arrived = next((cycle.time - cycles[0].time for cycle in cycles if cycle.arrived), None)
    near = [far for far in moments.nearest if np.isfinite(far)]
    return {
        "time": f"{cycles[-1].time - cycles[0].time:.1f} s",
        **({} if arrived is None else {"at the goal after": f"{arrived:.1f} s"}),
        "flown": f"{np.linalg.norm(way, axis=1).sum():.1f} m",
        **({"nearest return": f"{min(near):.2f} m"} if near else {}),
    }


def _missing(flight: LoggedFlight) -> list[str]:
    """What the log lacks."""
    cut = [] if flight.whole else ["The log ends in the middle: what came after is not in it."]
    left_out = f"{pluralize(flight.left_out, 'cycle')} left out, for which the disk was too slow."
    return [*cut, *([left_out] if flight.left_out else [])]


def _fours(actions: list[Any]) -> np.ndarray:
    return np.array([np.full(4, np.nan) if action is None else action for action in actions], np.float32)
