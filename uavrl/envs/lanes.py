"""Lanes of planes: straight over one wall, down to a level, along it, and up and out over another wall."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates

from uavrl.envs.tasks import Surface, grid_points
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

GRID = 0.5  # m, between two points of the map of clearances
STEP = 0.25  # m, between two places of a lane that are looked at, along the ground and along z: lanes dive at 45°
FLATNESS = np.array([1.0, 1.0, 2.0])  # a plane is at least twice as wide as high: heights count double in clearances
LOWEST = 1.8  # m above the valley's mean ground, of a level
BELOW_CEILING = 0.6  # m from the highest level to the ceiling
LEVEL_SHARE = 0.45  # of the valley's longer side, of which a lane's level part has at least the length: 18 m of 40
CHORDS = 512  # straight ways across the valley that are looked at together
ATTEMPTS = 16  # times that is done for one level


@dataclass(frozen=True)
class Lane:
    """A straight way through a valley, seen from above; from the side it dives to a level at 45° and climbs again.

    Args:
        corners: ``[C, 3]``, from where it comes in to where it leaves, in m.
    """

    corners: np.ndarray

    @cached_property
    def along(self) -> np.ndarray:
        """How far each corner is from the first: ``[C]`` in m."""
        return np.append(0.0, np.linalg.norm(np.diff(self.corners, axis=0), axis=1).cumsum())

    @property
    def length(self) -> float:
        """In metres."""
        return float(self.along[-1])

    def poses(self, flown: np.ndarray, backwards: bool = False) -> np.ndarray:
        """Returns x, y, z and yaw ``[N, 4]`` in m and rad after ``flown [N]`` metres, from its end if ``backwards``."""
        at = self.length - np.asarray(flown) if backwards else np.asarray(flown)
        places = [np.interp(at, self.along, axis) for axis in self.corners.T]
        return np.stack([*places, np.full(len(at), self.yaw(backwards))], -1)

    def yaw(self, backwards: bool = False) -> float:
        """Where a plane's nose points, in rad."""
        x, y, _ = (self.corners[-1] - self.corners[0]) * (-1 if backwards else 1)
        return float(np.arctan2(y, x))


class Airspace:
    """Where planes can fly in one valley: a flat ellipsoid, ``radius`` wide and half as high, meets nothing there."""

    def __init__(self, mesh: Mesh, size: tuple[float, float], top: float, radius: float) -> None:
        self.size, self.top, self.radius = np.array(size), top, radius
        self._surface = Surface(Mesh(mesh.vertices * FLATNESS, mesh.faces), -radius, 2 * top + radius)
        self._low = np.array([*(-self.size / 2), 0.0])
        axes = [
            np.arange(low, high + GRID, GRID) for low, high in zip(self._low, (*self.size / 2, self.top), strict=True)
        ]
        self._clearance = self._measured(grid_points(*axes), radius + GRID)

    def _measured(self, points: np.ndarray, longest: float) -> np.ndarray:
        return self._surface.clearance(points * FLATNESS, longest)

    def seems_free(self, points: np.ndarray) -> np.ndarray:
        """Returns which ``points [..., 3]`` seem to be free, from the map."""
        at = np.moveaxis((points - self._low) / GRID, -1, 0)
        return map_coordinates(self._clearance, at, order=1, mode="nearest") >= self.radius

    def is_free(self, lane: Lane) -> bool:
        """Whether a lane is free all along."""
        places = lane.poses(np.linspace(0.0, lane.length, int(np.ceil(lane.length / STEP)) + 1))[:, :3]
        return bool((self._measured(places, self.radius) >= self.radius - 1e-9).all())


def plan_lanes(
    rng: np.random.Generator,
    mesh: Mesh,
    size: tuple[float, float],
    top: float,
    ceiling: float,
    radius: float,
    count: int,
) -> list[Lane]:
    """Lanes of a valley, clear of its geometry, at levels spread from near the ground to near the ceiling."""
    airspace = Airspace(mesh, size, top, radius)
    highest = ceiling - BELOW_CEILING
    levels = rng.permutation(np.linspace(min(LOWEST, highest), highest, count))
    found = [lane for level in levels if (lane := _search(rng, airspace, level)) is not None]
    if not found:
        raise UavrlError(
            f"Planes need a straight way of {LEVEL_SHARE * max(size):.1f} m through the valley with {radius:.2f} m to "
            "both sides, and there is none; lower plane_wingspan, or how much stands there."
        )
    return found


def _search(rng: np.random.Generator, airspace: Airspace, level: float) -> Lane | None:
    """One lane at a level from edge to edge, or None where there is none."""
    rows = max(0, int(np.ceil((airspace.top - level) / STEP)))  # of which a dive has as many steps; 0 above all walls
    heights = level + STEP * np.arange(rows + 1)
    least = int(np.ceil(LEVEL_SHARE * max(airspace.size) / STEP))
    for _ in range(ATTEMPTS):
        start, end = _chords(rng, airspace.size)
        length = np.linalg.norm(end - start, axis=1)
        steps = np.arange(int(length.max() / STEP) + 1)
        ground = start[:, None] + STEP * steps[:, None] * ((end - start) / length[:, None])[:, None]
        inside = steps * STEP <= length[:, None]  # [chords, steps]
        long_enough = _longest(airspace.seems_free(_raised(ground, heights[:1]))[..., 0] & inside) >= least
        for way, within in zip(ground[long_enough], inside[long_enough], strict=True):
            free = airspace.seems_free(_raised(way, heights))
            first, last = _level_part(free[within])
            if last - first < least:
                continue
            places = [0, first - rows, first, last, last + rows, np.flatnonzero(within)[-1]]
            z = [heights[-1], heights[-1], level, level, heights[-1], heights[-1]]
            lane = Lane(np.column_stack([way[places], z]))
            if airspace.is_free(lane):
                return lane
    return None


def _raised(ground: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Places ``[..., H, 3]`` at some heights over each of ``ground [..., 2]``."""
    shape = (*ground.shape[:-1], len(heights))
    over = np.broadcast_to(ground[..., None, :], (*shape, 2))
    return np.concatenate([over, np.broadcast_to(heights[:, None], (*shape, 1))], -1)


def _longest(free: np.ndarray) -> np.ndarray:
    """How many steps the longest free part of each row of ``free [chords, steps]`` has."""
    run, longest = np.zeros(len(free), int), np.zeros(len(free), int)
    for column in free.T:
        run = (run + 1) * column
        longest = np.maximum(longest, run)
    return longest


def _chords(rng: np.random.Generator, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends ``[CHORDS, 2]`` on two edges each of a rectangle around the origin."""
    edges = rng.permuted(np.tile(np.arange(4), (CHORDS, 1)), axis=1)[:, :2]
    across = rng.uniform(-0.5, 0.5, (CHORDS, 2))
    side = np.where(edges % 2, 0.5, -0.5)
    along_y = edges < 2
    places = np.stack([np.where(along_y, side, across), np.where(along_y, across, side)], -1) * size
    return places[:, 0], places[:, 1]


def _level_part(free: np.ndarray) -> tuple[int, int]:
    """First and last step of the longest level part of a lane, between a dive and a climb; equal where there is none.

    Of ``free [steps, rows]`` the first row is the level and the last is where planes come in and leave; a dive moves by
    one step in each row.
    """
    dives = np.logical_and.accumulate(free[:, -1])
    climbs = np.logical_and.accumulate(free[::-1, -1])[::-1]
    for row in range(free.shape[1] - 2, -1, -1):
        dives = np.append(False, dives[:-1]) & free[:, row]
        climbs = np.append(climbs[1:], False) & free[:, row]
    best, first = (0, 0), -1
    for step, (level, dived, climbing) in enumerate(zip(free[:, 0], dives, climbs, strict=True)):
        first = -1 if not level else step if first < 0 and dived else first
        if first >= 0 and climbing and step - first > best[1] - best[0]:
            best = (first, step)
    return best
