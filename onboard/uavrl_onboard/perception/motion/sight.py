"""What moves around a LiDAR, by successive scans: where it is, how fast it flies, how large it is."""

from functools import partial
from itertools import pairwise

import numpy as np

from uavrl_onboard.geometry import Columns, body_to_world, yaw_rotation
from uavrl_onboard.perception.motion.occlusion import CellIndices, EarlierScans, Returns, find_returns
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.perception.motion.registration import LEAST_COMPARED, orthonormal, point_images, register, sample
from uavrl_onboard.perception.motion.tracks import AROUND, LINK, LabelledReturns, Track, follow, nearby
from uavrl_onboard.vehicle import VEHICLE

OBJECT = ("forward", "left", "up", "forward velocity", "left velocity", "up velocity", "size")
"""What is reported of one moving object, in m and m/s."""
LARGEST_VELOCITY, LARGEST_SIZE = 5.0, 2.5  # m/s and m, of an object, which a network reads as 1
DEPTH = 4  # earlier scans; in 0.4 s a body at 3 m/s flies 1.2 m, its own width
BESIDE = 0.4  # m around a body, in which its returns lie: its size is that of the returns that were followed
MARGIN = 0.3  # m, by which an earlier scan saw farther where something has come; within it, something has stayed


def scales(max_range: float) -> tuple[float, ...]:
    """What a network reads as 1 in each number of ``OBJECT``, where it is looked ``max_range`` m far."""
    return (*[max_range] * 3, *[LARGEST_VELOCITY] * 3, LARGEST_SIZE)


class MotionSight:
    """Finds what moves in the scans of N sensors that move themselves, scan by scan.

    A return is of a moving body if an earlier scan saw through where it lies: in its direction, and in the cells
    around, that scan saw farther. What comes into sight from behind an obstacle is not, as there the earlier scan saw
    the obstacle, which is nearer; nor is what lies outside the earlier scan's range and field of view. Returns that
    hang together begin a track, which a Kalman filter follows straight on; it counts once it was seen in three scans
    and moves at 1.5 to 8 m/s. Bodies that stand, or are larger than 2.5 m, are never reported.

    The sensors' own motion is taken from their velocities and attitudes, and corrected by laying each scan over the one
    before (`uavrl_onboard.perception.motion.registration`). Where these do not fit, the earlier scans are forgotten
    and nothing new is reported. Where the sensors are is not needed.

    Args:
        sensors: N.
        max_range: how far is looked, m; the scans must reach as far.
        objects: K that are reported, the nearest.
        period: time between two scans, s.
        pattern: how the rays of the sensors lie; by default as those of a VLP-16.

    Examples:
        A ball of 0.3 m flies to the left at 3 m/s, 6 m ahead of a sensor in free air:

        >>> sight, ring = MotionSight(1), np.linspace(-0.15, 0.15, 5)
        >>> ball = np.stack(np.broadcast_arrays(6.0, ring[:, None], ring), -1).reshape(1, -1, 3)
        >>> for step in range(8):
        ...     seen = sight.look(ball + [0.0, 0.3 * step, 0.0], np.zeros((1, 3)), np.zeros((1, 3)))
        >>> seen[0, 0].round(1) + 0.0
        array([6. , 2.1, 0. , 0. , 3. , 0. , 0.4], dtype=float32)
    """

    def __init__(
        self,
        sensors: int,
        max_range: float = 12.0,
        objects: int = 3,
        period: float = VEHICLE.period,
        pattern: ScanPattern = ScanPattern(),  # noqa: B008 - a tuple
    ) -> None:
        self.max_range, self.objects, self.period = max_range, objects, period
        self._scans = EarlierScans(sensors, DEPTH, pattern.grid, max_range)
        self._agreeing = pattern.agreeing
        self._ages = np.zeros(sensors, np.int64)  # of earlier scans, how many are known
        self._positions, self._velocities = np.zeros((2, sensors, 3))  # since the first scan
        self._rotations, self._attitudes = np.tile(np.eye(3), (2, sensors, 1, 1))
        self._images = np.zeros((3, sensors, self._scans.grid.rows, self._scans.grid.columns), np.float32)
        self._last = [np.zeros((0, 3), np.float32)] * sensors  # returns of the last scans in the world
        self._tracks: list[list[Track]] = [[] for _ in range(sensors)]
        self.bodies = [np.zeros((0, len(OBJECT)), np.float32)] * sensors  # all of each sensor, nearest first

    def reset(self, which: np.ndarray) -> None:
        """Forgets all that some sensors have seen, ``bool [N]``; their next scan is their first."""
        self._ages[which] = 0
        self._scans.reset(which)
        self._positions[which] = self._velocities[which] = 0.0
        for one in np.flatnonzero(which):
            self._tracks[one], self._last[one], self.bodies[one] = [], self._last[one][:0], self.bodies[one][:0]

    def look(
        self,
        clouds: np.ndarray,
        velocities: np.ndarray,
        attitudes: np.ndarray,
        which: np.ndarray | None = None,
        elapsed: float | None = None,
    ) -> np.ndarray:
        """Takes in another scan and returns the moving objects ``float32 [N, K, 7]``, nearest first, 0 for none.

        Each is ``OBJECT``: its position seen from the sensor and its velocity over ground, in axes that are level
        and point where the sensor's yaw does, and the diagonal of the box around its returns.

        Args:
            clouds: ``[N, P, 3]`` in m in the sensor frame; NaN, inf or zeros where a ray hit nothing.
            velocities: ``[N, 3]``, of the sensors in world axes in m/s.
            attitudes: ``[N, 3]``, their roll, pitch and yaw in rad.
            which: ``bool [N]``, which have a new scan; what the others report is not to be used. None: all.
            elapsed: since the scans before, s. None: ``period``.
        """
        which = np.ones(len(self._ages), bool) if which is None else which
        seen = find_returns(
            np.where(which[:, None, None], clouds, np.nan) if not which.all() else clouds, self.max_range
        )
        return self.look_at(seen, velocities, attitudes, which, elapsed)

    def look_at(
        self,
        seen: Returns,
        velocities: np.ndarray,
        attitudes: np.ndarray,
        which: np.ndarray,
        elapsed: float | None = None,
    ) -> np.ndarray:
        """Take in the returns of another scan, of the sensors ``which`` alone, as :meth:`look` does a scan."""
        elapsed = self.period if elapsed is None else elapsed
        cells = seen.in_cells(self._scans.grid)
        self._move(seen, cells, velocities, body_to_world(attitudes), which, elapsed)
        bounds = np.searchsorted(seen.clouds, np.arange(len(which) + 1))
        world = np.empty_like(seen.points)
        for one, (first, last) in enumerate(pairwise(bounds)):
            turned = self._rotations[one].astype(np.float32) @ seen.points[:, first:last]
            world[:, first:last] = turned + self._positions[one, :, None].astype(np.float32)
        moving, fresh = self._moving(world, seen.clouds)
        self._scans.add(seen, cells, self._rotations, self._positions, which)
        self._ages = np.where(which, np.minimum(self._ages + 1, DEPTH), self._ages)
        for one in np.flatnonzero(which).tolist():
            mine = slice(bounds[one], bounds[one + 1])
            scan = LabelledReturns(world[:, mine].T, moving[mine], fresh[mine])
            if self._tracks[one] or scan.fresh.any():
                self._tracks[one] = follow(self._tracks[one], scan, partial(self._before, one), elapsed)
            self._last[one] = scan.points
        return self._report(attitudes[:, 2])

    def _move(
        self,
        seen: Returns,
        cells: CellIndices,
        velocities: np.ndarray,
        attitudes: np.ndarray,
        which: np.ndarray,
        elapsed: float,
    ) -> None:
        """Moves the sensors ``which`` to where they now scan: as they say, corrected by what stands around them.

        Where the scans cannot be laid over each other, the earlier ones are forgotten.
        """
        known = which & (self._ages > 0)
        corrections = np.where(known[:, None, None], self._rotations @ self._attitudes.transpose(0, 2, 1), np.eye(3))
        rotations = corrections @ attitudes
        moved = elapsed * (corrections @ (velocities + self._velocities)[:, :, None] / 2)[:, :, 0]
        positions = self._positions + np.where(known[:, None], moved, 0.0)
        images = point_images(seen, len(which), self._scans.grid, cells)
        back = self._rotations.transpose(0, 2, 1)
        at = register(
            sample(images),
            self._images,
            self._scans.grid,
            back @ rotations,
            (back @ (positions - self._positions)[:, :, None])[:, :, 0],
        )
        good = known & at.fits & (at.compared >= LEAST_COMPARED)
        bad = known & ~at.fits & (at.compared >= LEAST_COMPARED)
        turned, shifted = (
            orthonormal(self._rotations @ at.rotations),
            (self._rotations @ at.places[:, :, None])[:, :, 0],
        )
        rotations = np.where(good[:, None, None], turned, rotations)
        positions = np.where(good[:, None], self._positions + shifted, positions)
        self._ages[bad] = 0
        for kept, new in (
            (self._rotations, rotations),
            (self._positions, positions),
            (self._velocities, velocities),
            (self._attitudes, attitudes),
        ):
            kept[which] = new[which]
        self._images[:, which] = images[:, which]

    def _moving(self, world: np.ndarray, clouds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which returns ``[3, M]`` may be of moving bodies, and which of these are fresh: ``bool [M]`` each.

        What the oldest scan saw where it is now has stayed; the rest is fresh where as many earlier scans saw through
        as have to agree.
        """
        beyond = self._scans.beyond(world, clouds, np.maximum(self._ages, 1))
        left = ~(np.abs(beyond) <= MARGIN)  # also where nothing is known
        moving = np.flatnonzero(left & (self._ages > 0)[clouds])
        agree, ages = (beyond.take(moving) > MARGIN).astype(np.int64), self._ages.take(clouds.take(moving))
        for age in range(1, DEPTH):
            asked = np.flatnonzero((agree < self._agreeing) & (ages > age))
            at = moving.take(asked)
            seen = self._scans.beyond(world.take(at, axis=1), clouds.take(at), np.full(len(self._ages), age))
            agree[asked] += seen > MARGIN
        fresh = agree >= self._agreeing
        masks = np.zeros((2, len(clouds)), bool)
        masks[0, moving], masks[1, moving[fresh]] = True, True
        return masks[0], masks[1]

    def _before(self, sensor: int, place: np.ndarray) -> LabelledReturns:
        """What was ``AROUND`` a place in the last scan, and what of it is now seen through."""
        points = self._last[sensor]
        points = points[nearby(points, place, AROUND)]
        clouds = np.full(len(points), sensor)
        left = self._scans.beyond(points.T, clouds, np.ones_like(self._ages)) > MARGIN
        return LabelledReturns(points, left, left)

    def _report(self, yaws: np.ndarray) -> np.ndarray:
        """The nearest tracks that count, ``[N, K, 7]``."""
        found = np.zeros((len(yaws), self.objects, len(OBJECT)), np.float32)
        for one, (tracks, yaw) in enumerate(zip(self._tracks, yaws, strict=True)):
            self.bodies[one] = self.bodies[one][:0]
            if not tracks:
                continue
            level = yaw_rotation(-yaw) @ self._attitudes[one] @ self._rotations[one].T
            objects = [
                [*(level @ (track.position - self._positions[one])), *(level @ track.velocity), track.size]
                for track in tracks
                if track.is_confirmed
            ]
            distances = [float(np.linalg.norm(values[:3])) for values in objects]
            nearest = [row for row in np.argsort(distances) if distances[row] < self.max_range]
            self.bodies[one] = np.array([objects[row] for row in nearest], np.float32).reshape(-1, len(OBJECT))
            for slot, row in enumerate(nearest[: self.objects]):
                found[one, slot] = objects[row]
        return found

    def of_bodies(self, scan: Columns, sensor: int) -> np.ndarray | None:
        """Return which returns of the last scan of a sensor are of its moving bodies, ``bool [M]``; None for none.

        A point around a body belongs to it if the nearest return that was looked at does: a wall beside or behind the
        body stays.

        Args:
            scan: all returns of that one.
            sensor: its number.
        """
        tracks = [track for track in self._tracks[sensor] if track.is_confirmed and len(track.body)]
        if not tracks:
            return None
        from scipy.spatial import cKDTree  # here, since SciPy loads in half a second and only moving bodies need it

        looked_at, rotation = self._last[sensor], self._rotations[sensor]
        own, moving = np.zeros(len(looked_at), bool), np.zeros(len(scan.squared), bool)
        for track in tracks:
            own[track.body] = True
        for track in tracks:
            reach = track.size / 2 + BESIDE
            at = nearby(scan.points.T, rotation.T @ (track.position - self._positions[sensor]), reach)
            around = nearby(looked_at, track.position, reach + LINK)
            if len(around) and own[around].all():  # nothing stands near it
                moving[at] = True
                continue
            world = scan.rows(at) @ rotation.T + self._positions[sensor]
            moving[at] |= own[around[cKDTree(looked_at[around]).query(world)[1]]]
        return moving
