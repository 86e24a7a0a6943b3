"""Traps: walls that catch what flies straight at its goal and does not remember, and the tasks that lead into them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from uavrl.envs.obstacles import TALL, Obstacle
from uavrl.envs.tasks import CELL, JITTER, FlightMap
from uavrl.envs.terrain import FLOOR_AMPLITUDE, WALL_WIDTH
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import yaw_rotation
from uavrl_onboard.guards.map.grid import Slices, grid_graph
from uavrl_onboard.mesh import Mesh

THICKNESS = (0.3, 0.5)  # m, of a wall
DEEP = -2.5  # m, world z of a wall's foot: below all ground inside the valley
TALLER = 1.0  # m, that a wall rises over the tallest ceiling, or over an obstacle's least height
PASSAGE = 2.5  # m, kept free between two traps, and between one and the slope of the border
BEHIND = 4.0  # m, that the valley goes on behind a closed side: there are goals
EDGE = 0.5  # m, from the ends of a closed side within which a straight line does not count as caught
SIGHT = 3.5  # m, from a gap within which likewise: from there a policy sees it
TRIES, LAYOUTS = 60, 40  # places tried for one trap, and how often all are placed anew
LONGEST_WAY = 33.0  # m, of a task's way by the map: 300 steps at 1.1 m/s
GOALS, TRIED_GOALS = 16, 200  # whose ways are computed for each trap, and among how many they are looked for


@dataclass(frozen=True)
class Trap:
    """One trap in its valley's frame, as lines in the plane.

    Args:
        kind: ``u``, ``canyon`` or ``gap``.
        walls: middles of its walls, ``[W, 2, 2]`` m.
        closed: those parts that a straight way to the goal must not meet from within, ``[S, 2, 2]`` m.
        inwards: unit vector ``[2]`` from its mouth to its closed side; 0 where both sides are alike.
        inside: a line along the middle of what must stay free of obstacles, ``[2, 2]`` m.
        room: half the width of that, m.
        thickness: of its walls, m.
    """

    kind: str
    walls: np.ndarray
    closed: np.ndarray
    inwards: np.ndarray
    inside: np.ndarray
    room: float
    thickness: float

    def moved(self, yaw: float, offset: np.ndarray) -> "Trap":
        """It, turned by ``yaw`` rad about the origin and then moved by ``offset [2]`` m."""
        turn = yaw_rotation(-yaw)[:2, :2]  # of rows
        lines = (self.walls @ turn + offset, self.closed @ turn + offset)
        return Trap(self.kind, *lines, self.inwards @ turn, self.inside @ turn + offset, self.room, self.thickness)

    def obstacle(self, top: float) -> Obstacle:
        """It as an obstacle whose walls reach up to the height ``top`` in m."""
        mesh = Mesh.merge(wall(line, self.thickness, DEEP, top) for line in self.walls)
        low, high = self.walls.min((0, 1)), self.walls.max((0, 1))
        x, y = ((low + high) / 2).tolist()
        return Obstacle(self.kind, (x, y, 0.0), float(np.linalg.norm(high - low) / 2), mesh)

    def taken(self) -> np.ndarray:
        """Circles ``[K, 3]``, x, y and radius in m, that keep other obstacles away."""
        rows = [(along(line, 1.0), self.thickness) for line in self.walls] + [(along(self.inside, 1.0), self.room)]
        return np.concatenate([np.column_stack([points, np.full(len(points), radius)]) for points, radius in rows])

    def catches(self, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Which straight lines from ``starts [A, 2]`` to ``goals [B, 2]`` meet its closed side from within: ``[A, B]``.

        Of a U or a canyon they meet no other wall before or after it.
        """
        ahead = goals - starts[:, None]
        if not self.inwards.any():
            return np.any([crosses(starts, goals, side) for side in self.closed], axis=0)
        arms = self.walls[1:]
        clear = ~np.any([crosses(starts, goals, arm) for arm in arms], axis=0)
        return clear & crosses(starts, goals, self.closed[0]) & (ahead @ self.inwards > 0)


def along(line: np.ndarray, step: float) -> np.ndarray:
    """Points ``[P, 2]`` on a line ``[2, 2]``, at most ``step`` m apart, with its ends."""
    count = int(np.ceil(np.linalg.norm(line[1] - line[0]) / step)) + 1
    return line[0] + np.linspace(0, 1, max(count, 2))[:, None] * (line[1] - line[0])


def crosses(starts: np.ndarray, goals: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Which straight ways from ``starts [A, 2]`` to ``goals [B, 2]`` cross the line ``[2, 2]``: ``bool [A, B]``.

    Examples:
        >>> line = np.array([[0.0, -1.0], [0.0, 1.0]])
        >>> crosses(np.array([[-1.0, 0.0]]), np.array([[1.0, 0.5], [1.0, 5.0], [-0.5, 0.0]]), line)
        array([[ True, False, False]])
    """

    def side(of: np.ndarray) -> np.ndarray:
        (ax, ay), (bx, by) = line
        return (bx - ax) * (of[..., 1] - ay) - (by - ay) * (of[..., 0] - ax)

    def turn(end: np.ndarray) -> np.ndarray:
        a, b = goals - starts[:, None], end - starts[:, None]
        return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

    return ((side(starts)[:, None] > 0) != (side(goals) > 0)) & ((turn(line[0]) > 0) != (turn(line[1]) > 0))


def wall(line: np.ndarray, thickness: float, low: float, high: float) -> Mesh:
    """A wall along a line ``[2, 2]``, a closed box between two heights in m, longer by half its thickness at each end.

    Examples:
        >>> mesh = wall(np.array([[0.0, 0.0], [4.0, 0.0]]), 0.4, -1.0, 7.0)
        >>> bool(np.allclose([mesh.vertices.min(0), mesh.vertices.max(0)], [[-0.2, -0.2, -1], [4.2, 0.2, 7]]))
        True
    """
    ahead = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0]) * thickness / 2
    aside = np.array([-ahead[1], ahead[0]])
    a, b = line[0] - ahead, line[1] + ahead
    ring = np.array([a - aside, b - aside, b + aside, a + aside])  # anticlockwise from above
    vertices = np.concatenate([np.column_stack([ring, np.full(4, height)]) for height in (low, high)])
    sides = [face for i, j in pairwise((0, 1, 2, 3, 0)) for face in ((i, j, j + 4), (i, j + 4, i + 4))]
    return Mesh(vertices, np.array([*sides, (4, 5, 6), (4, 6, 7), (0, 2, 1), (0, 3, 2)]))


def pocket(kind: str, rng: np.random.Generator, wide: float, deep: float) -> Trap:
    """A U around the origin that opens towards -x: its back and two arms, ``wide`` and ``deep`` in m."""
    y, x = wide / 2, deep / 2
    back = np.array([[x, -y], [x, y]])
    arms = [[[-x, side], [x, side]] for side in (-y, y)]
    closed = back + np.array([[0, EDGE], [0, -EDGE]])
    inside = np.array([[-x - PASSAGE, 0.0], [x, 0.0]])
    thickness = rng.uniform(*THICKNESS)
    return Trap(kind, np.array([back, *arms]), closed[None], np.array([1.0, 0.0]), inside, y, thickness)


def u(rng: np.random.Generator, size: tuple[float, float]) -> Trap:
    """A U, about as wide as deep."""
    return pocket("u", rng, rng.uniform(5.5, 6.5), rng.uniform(4.5, 5.5)).moved(
        rng.uniform(0, 2 * np.pi), _place(rng, size)
    )


def canyon(rng: np.random.Generator, size: tuple[float, float]) -> Trap:
    """A box canyon: two long walls in parallel, closed at one end, of which one sees nothing from its mouth."""
    trap = pocket("canyon", rng, rng.uniform(4.0, 4.8), rng.uniform(7.5, 9.0))
    return trap.moved(rng.uniform(0, 2 * np.pi), _place(rng, size))


def gap(rng: np.random.Generator, size: tuple[float, float]) -> Trap:
    """A wall across the shorter side of the valley, from border to border, with one gap of 2.2 to 2.8 m."""
    half, thickness = min(size) / 2, rng.uniform(*THICKNESS)
    free, place = rng.uniform(2.2, 2.8) / 2 + thickness / 2, rng.choice((-1.0, 1.0)) * rng.uniform(0.2, 0.55) * half
    ends = half - thickness
    walls = np.array([[[0, -ends], [0, place - free]], [[0, place + free], [0, ends]]])
    closed = walls + np.array([[[0, 0], [0, -SIGHT]], [[0, SIGHT], [0, 0]]])
    closed = closed[closed[:, 1, 1] - closed[:, 0, 1] > EDGE]
    inside = np.array([[-PASSAGE, place], [PASSAGE, place]])
    trap = Trap("gap", walls, closed, np.zeros(2), inside, free, thickness)
    offset = np.array([rng.uniform(-0.2, 0.2) * max(size), 0.0])
    return trap.moved(0.0, offset) if size[0] >= size[1] else trap.moved(np.pi / 2, offset[::-1])


def _place(rng: np.random.Generator, size: tuple[float, float]) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, 2) * size


KINDS = (u, canyon, gap)  # dealt out in this order


def place_traps(rng: np.random.Generator, count: int, size: tuple[float, float]) -> list[Trap]:
    """Returns ``count`` traps with a passage between each other and around them, all inside the valley.

    Raises:
        UavrlError: if they do not fit.
    """
    kinds = sorted((KINDS[i % len(KINDS)] for i in range(count)), key=lambda kind: kind is not gap)  # the long first
    for _ in range(LAYOUTS):
        traps: list[Trap] = []
        for kind in kinds:
            tried = (kind(rng, size) for _ in range(TRIES))
            fits = next((trap for trap in tried if _fits(trap, traps, size)), None)
            if fits is None:
                break
            traps.append(fits)
        if len(traps) == count:
            return traps
    raise UavrlError(f"traps must leave passages of {PASSAGE} m, got {count} in {size} m; lower traps or enlarge size.")


def _fits(trap: Trap, others: list[Trap], size: tuple[float, float]) -> bool:
    """Whether a trap leaves passages to others and to the valley's border, and room for goals behind it."""
    points, half = np.concatenate([along(line, 0.5) for line in trap.walls]), np.array(size) / 2 - WALL_WIDTH
    if trap.kind != "gap":
        beyond = np.abs(trap.inside[1] + BEHIND * trap.inwards)
        if (np.abs(points) > half - PASSAGE).any() or (beyond > half).any():
            return False
    taken = [along(line, 0.5) for other in others for line in other.walls]
    return not taken or np.linalg.norm(points[:, None] - np.concatenate(taken), axis=-1).min() >= PASSAGE


def trap_top(ceiling: float) -> float:
    """Height in m up to which walls reach: over the ceiling above the valley's highest floor."""
    return max(TALL, FLOOR_AMPLITUDE + ceiling + TALLER)


def trapped(
    rng: np.random.Generator, flight: FlightMap, traps: list[Trap], level: float, radius: float, min_distance: float
) -> list[np.ndarray]:
    """For each trap that catches any, the tasks whose straight way ends in it and whose way by the map is short enough.

    Ways are those of a ball of ``radius`` m at flight level, from point to point of the map, in eight directions.

    Args:
        rng: chooses the goals.
        flight: the valley's map.
        traps: in it.
        level: of the flight, m.
        radius: of the UAV, m.
        min_distance: least distance from start to goal, m.

    Returns:
        Start and goal as indices into ``flight.candidates``, ``[P, 2]`` each.
    """
    places, found = flight.candidates, []
    if not traps:
        return []
    graph, nodes = ways_at(flight, level, radius)
    for trap in traps:
        goals = rng.permutation(len(places))[:TRIED_GOALS]
        apart = np.linalg.norm(places[:, None] - places[goals], axis=-1)
        caught = trap.catches(places, places[goals]) & (apart >= min_distance + 2 * JITTER)
        some = np.flatnonzero(caught.any(0))[:GOALS]
        if not len(some):
            continue
        ways = dijkstra(graph, indices=nodes[goals[some]], limit=LONGEST_WAY)[:, nodes].T
        start, goal = np.nonzero(caught[:, some] & (ways <= LONGEST_WAY))
        if len(start):
            found.append(np.stack([start, goals[some[goal]]], -1))
    return found


def ways_at(flight: FlightMap, level: float, radius: float) -> tuple[csr_array, np.ndarray]:
    """The ways at flight level between points of the map, and the nodes of its candidates."""
    space = flight.space
    at = flight.at(level)
    allowed, clearance = flight.corridor[:, :, at], space.clearance[:, :, at]

    def weighed(here: Slices, there: Slices, apart: float) -> tuple[np.ndarray, np.ndarray]:
        length = CELL * apart
        fits = allowed[here] & allowed[there] & (clearance[here] + clearance[there] >= 2 * radius + length)
        return fits, np.full(fits.shape, length)

    graph, index = grid_graph(allowed.shape, weighed)
    cell = np.rint((flight.candidates - (space.x[0], space.y[0])) / CELL).astype(int)
    return graph, index[cell[:, 0], cell[:, 1]]
