"""Planes that cross the valleys between the obstacles."""

from collections.abc import Sequence

import numpy as np

from uavrl.envs.lanes import Lane
from uavrl.envs.mesh import tube
from uavrl.envs.world import World
from uavrl_onboard.mesh import Mesh, loft

WING_GAP = 0.36  # between the two wings of a plane, as a share of its wingspan


def plane_mesh(wingspan: float) -> Mesh:
    """Returns a biplane around the origin: nose along +x, wings along y, fin along +z."""
    fuselage = tube(
        np.stack([np.array([0.45, 0.38, 0.2, -0.15, -0.35]), np.zeros(5)], -1),
        np.array([0.015, 0.06, 0.09, 0.06, 0.02]),
    )
    wing = loft(_sections(np.array([-0.5, 0.0, 0.5]), np.array([0.12, 0.2, 0.12]), np.array([0.06, 0.1, 0.06]), 0.014))
    tail = _sections(np.array([-0.18, 0.0, 0.18]), np.array([0.06, 0.1, 0.06]), np.array([-0.34, -0.3, -0.34]), 0.01)
    fin = _sections(np.array([0.0, 0.22]), np.array([0.14, 0.08]), np.array([-0.27, -0.32]), 0.01)
    strut = tube(np.array([[0.02, -WING_GAP / 2], [0.02, WING_GAP / 2]]), np.array([0.02, 0.02]), sides=4)
    parts = Mesh.merge(
        [
            fuselage,
            wing.translated((0.0, 0.0, WING_GAP / 2)),
            wing.translated((0.0, 0.0, -WING_GAP / 2)),
            *(strut.translated((0.0, y, 0.0)) for y in (-0.42, -0.16, 0.16, 0.42)),
            loft(tail),
            loft(fin[..., [0, 2, 1]]),
        ]
    )
    return Mesh(parts.vertices * wingspan, parts.faces)


def _sections(span: np.ndarray, chord: np.ndarray, lead: np.ndarray, thickness: float) -> np.ndarray:
    """Returns a wing's diamond sections ``[S, 4, 3]`` at y = ``span [S]``, ``chord [S]`` long from x = ``lead [S]``."""
    outline = np.array([[0.0, 0.0], [-0.4, 1.0], [-1.0, 0.0], [-0.4, -1.0]])
    x = lead[:, None] + chord[:, None] * outline[:, 0]
    y = np.broadcast_to(span[:, None], x.shape)
    return np.stack([x, y, np.broadcast_to(thickness * outline[:, 1], x.shape)], -1)


class Leg:
    """One plane's way along a lane of its valley, and the plane's own source of the next ones."""

    def __init__(self, rng: np.random.Generator, lanes: Sequence[Lane], speed: tuple[float, float]) -> None:
        self._rng, self._lanes, self._speeds = rng, lanes, speed
        self._enter()
        self.flown = float(rng.uniform(0, self.lane.length))

    def _enter(self) -> None:
        """Draws a lane, which way to fly it, and a speed."""
        self.lane = self._lanes[int(self._rng.integers(len(self._lanes)))]
        self.backwards = bool(self._rng.random() < 0.5)
        self.speed = float(self._rng.uniform(*self._speeds))
        self.flown = 0.0

    def poses(self, flown: np.ndarray) -> np.ndarray:
        """Returns x, y, z and yaw ``[N, 4]`` in metres and rad after ``flown [N]`` metres of this leg."""
        return self.lane.poses(flown, self.backwards)

    def fly(self, steps: int, dt: float) -> np.ndarray:
        """Flies on and returns x, y, z and yaw ``[steps, 4]`` after each step; a new leg starts when one ends."""
        path: list[np.ndarray] = []
        elapsed = 0.0  # s, at the start of the current leg, or 0
        while len(path) < steps:
            flown = self.flown + self.speed * (np.arange(len(path) + 1, steps + 1) * dt - elapsed)
            path.extend(self.poses(flown[flown <= self.lane.length]))
            if len(path) < steps:
                elapsed += (self.lane.length - self.flown) / self.speed
                self._enter()
        self.flown += self.speed * (steps * dt - elapsed)
        return np.array(path).reshape(steps, 4)


class Ways:
    """The legs of K planes as arrays, to place all planes at once where each leg would, to the last digit."""

    def __init__(self, legs: Sequence[Leg]) -> None:
        corners = max((len(leg.lane.corners) for leg in legs), default=2)
        self.corners, self.along = np.zeros((len(legs), corners, 3)), np.zeros((len(legs), corners))
        self.flown, self.speed, self.length, self.yaw = np.zeros((4, len(legs)))
        self.backwards = np.zeros(len(legs), dtype=bool)
        for plane, leg in enumerate(legs):
            self.take(plane, leg)

    def take(self, plane: int, leg: Leg) -> None:
        """Takes over a plane's leg."""
        lane, ends = leg.lane, len(leg.lane.corners)
        self.corners[plane], self.along[plane] = lane.corners[-1], lane.length
        self.corners[plane, :ends], self.along[plane, :ends] = lane.corners, lane.along
        self.flown[plane], self.speed[plane], self.length[plane] = leg.flown, leg.speed, lane.length
        self.backwards[plane], self.yaw[plane] = leg.backwards, lane.yaw(leg.backwards)

    def poses(self, flown: np.ndarray) -> np.ndarray:
        """X, y, z in m and yaw in rad ``[K, T, 4]`` after ``flown [K, T]`` metres, as :meth:`Lane.poses` has them."""
        at = np.where(self.backwards[:, None], self.length[:, None] - flown, flown)
        behind = (self.along[:, None] <= at[..., None]).sum(-1) - 1
        last = self.along.shape[1] - 1
        start, end = np.clip(behind, 0, last), np.clip(behind + 1, 0, last)
        row = np.arange(len(at))[:, None]
        length = self.along[row, end] - self.along[row, start]
        first = self.corners[row, start]
        slope = (self.corners[row, end] - first) / np.where(length > 0, length, 1.0)[..., None]
        places = slope * (at - self.along[row, start])[..., None] + first
        return np.concatenate([places, np.broadcast_to(self.yaw[:, None, None], (*at.shape, 1))], axis=-1)


class Traffic:
    """All planes of the world: they fly on whatever the episodes do, and do not see the UAVs.

    Each comes in over a wall, dives, flies straight and level between the obstacles at a height that UAVs use, climbs
    and leaves over another wall, at a constant speed drawn per leg; then it comes in again elsewhere. All randomness
    comes from ``rng``, and does not depend on how the time is cut into calls.

    Source: Chansuparp (2022), §4.1: three planes at the UAV's flight level with a constant speed above 2 m/s. A UAV may
    leave that level, so the planes' levels are spread over all heights below the ceiling (this library's choice).
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        config = world.config
        self.mesh = plane_mesh(config.plane_wingspan)
        self.places = np.repeat(np.arange(len(world.places)), config.planes)
        self._origins = np.array([world.places[v].origin for v in self.places]).reshape(-1, 2)
        seeds = rng.integers(2**63, size=(len(config.seeds), config.planes))[world.built].ravel()
        self.legs = [
            Leg(np.random.default_rng(seed), world.places[place].lanes, config.plane_speed)
            for seed, place in zip(seeds, self.places, strict=True)
        ]
        self._ways = Ways(self.legs)

    @property
    def positions(self) -> np.ndarray:
        """Where the planes are: ``[K, 3]`` in metres, those of the first valley first."""
        return self.poses()[:, :3]

    def poses(self) -> np.ndarray:
        """X, y, z in metres and yaw in rad, in [-π, π], of all planes now: ``[K, 4]``."""
        return self._in_world(self._ways.poses(self._ways.flown[:, None])[:, 0])

    def velocities(self) -> np.ndarray:
        """The velocities of all planes, ``[K, 3]`` in m/s; near the end of a leg a plane is on it for the last time."""
        ways, dt = self._ways, 0.01
        ahead = ways.poses((ways.flown + ways.speed * dt)[:, None])[:, 0]
        return (ahead - ways.poses(ways.flown[:, None])[:, 0])[:, :3] / dt

    def advance(self, steps: int, dt: float) -> np.ndarray:
        """Flies on by ``steps`` times ``dt`` s: x, y, z in m and yaw in rad after each, ``[steps, K, 4]``."""
        ways = self._ways
        flown = ways.flown[:, None] + ways.speed[:, None] * (np.arange(1, steps + 1) * dt)
        path = ways.poses(flown)
        for plane in np.flatnonzero((flown > ways.length[:, None]).any(1)).tolist():
            leg = self.legs[plane]
            leg.flown = float(ways.flown[plane])
            path[plane] = leg.fly(steps, dt)
            ways.take(plane, leg)
            flown[plane] = leg.flown
        ways.flown = flown[:, -1] if steps else ways.flown
        return self._in_world(path.transpose(1, 0, 2))

    def _in_world(self, poses: np.ndarray) -> np.ndarray:
        """Moves x, y, z and yaw ``[..., K, 4]`` from the valleys' frames into the world's, the yaws to [-π, π]."""
        yaw = (poses[..., 3:] + np.pi) % (2 * np.pi) - np.pi
        return np.concatenate([poses[..., :2] + self._origins, poses[..., 2:3], yaw], axis=-1)
