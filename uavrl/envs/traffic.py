"""Planes that cross the valleys at flight level."""

from __future__ import annotations

from typing import Any

import numpy as np

from uavrl.envs.mesh import Mesh
from uavrl.envs.shapes import loft, tube
from uavrl.envs.world import World


def plane_mesh(wingspan: float) -> Mesh:
    """Returns a plane around the origin: nose along +x, wings along y, fin along +z.

    Args:
        wingspan: In metres; all else is in proportion to it.

    Examples:
        >>> mesh = plane_mesh(2.0)
        >>> np.ptp(mesh.vertices, axis=0).astype(float).round(1).tolist()
        [1.7, 2.0, 0.5]
    """
    fuselage = tube(
        np.stack([np.array([0.45, 0.38, 0.2, -0.15, -0.35]), np.zeros(5)], -1),
        np.array([0.015, 0.045, 0.06, 0.045, 0.02]),
    )
    wings = _sections(np.array([-0.5, 0.0, 0.5]), np.array([0.1, 0.2, 0.1]), np.array([0.02, 0.1, 0.02]), 0.012)
    tail = _sections(np.array([-0.18, 0.0, 0.18]), np.array([0.06, 0.1, 0.06]), np.array([-0.34, -0.3, -0.34]), 0.008)
    fin = _sections(np.array([0.0, 0.17]), np.array([0.12, 0.07]), np.array([-0.29, -0.33]), 0.008)
    parts = Mesh.merge([fuselage, loft(wings), loft(tail), loft(fin[..., [0, 2, 1]])])
    return Mesh(parts.vertices * wingspan, parts.faces)


def _sections(span: np.ndarray, chord: np.ndarray, lead: np.ndarray, thickness: float) -> np.ndarray:
    """Returns a wing's diamond sections ``[S, 4, 3]`` at y = ``span [S]``, ``chord [S]`` long from x = ``lead [S]``."""
    outline = np.array([[0.0, 0.0], [-0.4, 1.0], [-1.0, 0.0], [-0.4, -1.0]])
    x = lead[:, None] + chord[:, None] * outline[:, 0]
    y = np.broadcast_to(span[:, None], x.shape)
    return np.stack([x, y, np.broadcast_to(thickness * outline[:, 1], x.shape)], -1)


class Leg:
    """The straight flight of one plane across its valley, and the plane's own source of the next ones.

    Args:
        rng: The plane's own generator.
        size: Extent of the valley along x and y in metres.
        speed: Least and greatest speed in m/s.

    Examples:
        >>> leg = Leg(np.random.default_rng(0), (40.0, 30.0), (2.5, 4.0))
        >>> path = leg.fly(steps=3, dt=0.1)
        >>> path.shape, bool(2.5 <= np.linalg.norm(path[1, :2] - path[0, :2]) / 0.1 <= 4.0)
        ((3, 3), True)
    """

    def __init__(self, rng: np.random.Generator, size: tuple[float, float], speed: tuple[float, float]) -> None:
        self._rng, self._half, self._speeds = rng, np.array(size) / 2, speed
        self._enter()
        self.flown = float(rng.uniform(0, self.length))

    def _enter(self) -> None:
        """Draws a leg from one edge to another, at least half as long as the valley's shorter side."""
        while True:
            edges = self._rng.permutation(4)[:2]
            self.start, end = (self._on_edge(edge) for edge in edges)
            self.length = float(np.linalg.norm(end - self.start))
            if self.length >= self._half.min():
                break
        self.direction = (end - self.start) / self.length
        self.speed = float(self._rng.uniform(*self._speeds))
        self.flown = 0.0

    def _on_edge(self, edge: int) -> np.ndarray:
        """Returns a random point ``[2]`` on edge 0 to 3: -x, +x, -y, +y."""
        point = self._rng.uniform(-self._half, self._half)
        point[edge // 2] = self._half[edge // 2] * (1 if edge % 2 else -1)
        return point

    def pose(self, flown: np.ndarray) -> np.ndarray:
        """Returns x, y and yaw ``[N, 3]`` in metres and rad after ``flown [N]`` metres of this leg."""
        xy = self.start + np.asarray(flown)[:, None] * self.direction
        yaw = np.arctan2(self.direction[1], self.direction[0])
        return np.column_stack([xy, np.full(len(xy), yaw)])

    def fly(self, steps: int, dt: float) -> np.ndarray:
        """Flies on and returns x, y and yaw ``[steps, 3]`` after each step; a new leg starts where one ends."""
        path: list[np.ndarray] = []
        elapsed = 0.0  # s, at the start of the current leg, or 0
        while len(path) < steps:
            flown = self.flown + self.speed * (np.arange(len(path) + 1, steps + 1) * dt - elapsed)
            path.extend(self.pose(flown[flown <= self.length]))
            if len(path) < steps:
                elapsed += (self.length - self.flown) / self.speed
                self._enter()
        self.flown += self.speed * (steps * dt - elapsed)
        return np.array(path).reshape(steps, 3)

    def state_dict(self) -> dict[str, Any]:
        """Returns all that the rest of the flight depends on."""
        names = ("start", "direction", "length", "speed", "flown")
        return {"generator": self._rng.bit_generator.state} | {name: np.copy(getattr(self, name)) for name in names}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Flies on as the leg that ``state_dict`` was taken from."""
        self._rng.bit_generator.state = state["generator"]
        self.start, self.direction = np.array(state["start"]), np.array(state["direction"])
        self.length, self.speed, self.flown = (float(state[name]) for name in ("length", "speed", "flown"))


class Traffic:
    """All planes of the world: they fly on whatever the episodes do, and do not see the UAVs.

    Each crosses its valley in straight legs at flight level, at a constant speed drawn per leg, and re-enters from a
    random edge. All randomness comes from ``rng``, and does not depend on how the time is cut into calls.

    Source: Chansuparp (2022), §4.1: three planes at the UAV's flight level with a constant speed above 2 m/s.

    Args:
        world: Gives the valleys and, in its config, the number, speed and wingspan of the planes.
        rng: Source of all legs.

    Examples:
        >>> from uavrl.envs.world import WorldConfig
        >>> traffic = Traffic(World(WorldConfig(planes=3)), np.random.default_rng(0))
        >>> traffic.advance(steps=24, dt=1 / 240).shape, traffic.positions[:, 2].tolist()
        ((24, 3, 4), [3.5, 3.5, 3.5])
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        config = world.config
        self.mesh = plane_mesh(config.plane_wingspan)
        self.valleys = np.repeat(np.arange(len(world.valleys)), config.planes)
        self._level = config.flight_level
        self._origins = np.array([world.valleys[v].origin for v in self.valleys]).reshape(-1, 2)
        seeds = rng.integers(2**63, size=len(self.valleys))
        self._legs = [Leg(np.random.default_rng(seed), config.size, config.plane_speed) for seed in seeds]

    @property
    def positions(self) -> np.ndarray:
        """Where the planes are: ``[K, 3]`` in metres, those of the first valley first."""
        return self._poses()[:, :3]

    @property
    def yaws(self) -> np.ndarray:
        """Headings ``[K]`` in rad, in [-π, π]."""
        return self._poses()[:, 3]

    def advance(self, steps: int, dt: float) -> np.ndarray:
        """Flies on by ``steps`` times ``dt`` seconds.

        Args:
            steps: Number of time steps.
            dt: Length of one in seconds.

        Returns:
            ``[steps, K, 4]``: x, y, z in metres and yaw in rad after each of the steps.
        """
        paths = [leg.fly(steps, dt) for leg in self._legs]
        return self._in_world(np.stack(paths, axis=1) if paths else np.zeros((steps, 0, 3)))

    def state_dict(self) -> dict[str, Any]:
        """Returns all that the rest of the traffic depends on."""
        return {"legs": [leg.state_dict() for leg in self._legs]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Flies on as the traffic that ``state_dict`` was taken from."""
        if len(state["legs"]) != len(self._legs):
            raise ValueError(
                f"This traffic has {len(self._legs)} planes, the state has {len(state['legs'])}; "
                "load it into a world with the same planes and seeds."
            )
        for leg, saved in zip(self._legs, state["legs"], strict=True):
            leg.load_state_dict(saved)

    def _poses(self) -> np.ndarray:
        """Returns x, y, z and yaw ``[K, 4]`` now."""
        poses = [leg.pose(np.array([leg.flown]))[0] for leg in self._legs]
        return self._in_world(np.array(poses).reshape(-1, 3))

    def _in_world(self, poses: np.ndarray) -> np.ndarray:
        """Turns x, y, yaw ``[..., K, 3]`` of the valleys' frames into x, y, z, yaw ``[..., K, 4]`` of the world."""
        level = np.full((*poses.shape[:-1], 1), self._level)
        return np.concatenate([poses[..., :2] + self._origins, level, poses[..., 2:]], axis=-1)
