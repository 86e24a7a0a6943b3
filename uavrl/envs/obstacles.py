"""Obstacles of the valley, about equally dense from the ground to the ceiling and from wall to wall."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uavrl.envs.mesh import blob, tube, turned
from uavrl.envs.terrain import HeightField
from uavrl_onboard.mesh import Mesh

ROOT = -1.2  # m: obstacles reach this far below the ground at their middle, so that none floats over a slope
GAP = 1.3  # m that the circles around two obstacles keep between them where there is room
ATTEMPTS = 40  # places tried for one obstacle before the roomiest of them is taken
MARGIN = 1.0  # m from the border within which nothing but a buttress has its middle: there the wall is the obstacle
FOOT = 1.5  # m around its middle within which an obstacle stands on the lowest ground
TALL = 6.5  # m: what towers over the ceiling of 5 m is at least this tall


@dataclass(frozen=True)
class Obstacle:
    """One obstacle in its valley's frame."""

    kind: str
    position: tuple[float, float, float]
    radius: float
    mesh: Mesh


def tree(rng: np.random.Generator) -> Mesh:
    """Returns a fir that reaches past the ceiling, with three tiers of branches around the flight level."""
    girth, lean, height = rng.uniform(0.14, 0.26), rng.uniform(-0.5, 0.5), rng.uniform(TALL, 8.5)
    along = np.linspace(0, 1, 4)
    path = np.stack([lean * along**2, _from_root(height, along)], -1)
    parts = [tube(path, girth * (1.3 - 0.5 * along), sides=7)]
    wide, low, rise = rng.uniform(0.8, 1.2), rng.uniform(1.4, 2.6), rng.uniform(1.2, 1.5)
    for tier in range(3):
        level = low + rise * tier
        cone = np.stack([np.full(3, lean * (level / height) ** 2), level + rise * np.array([-0.15, 0.0, 1.2])], -1)
        parts.append(tube(cone, wide * (1 - 0.15 * tier) * np.array([0.3, 1.0, 0.15]), sides=9))
    return Mesh.merge(parts)


def spire(rng: np.random.Generator) -> Mesh:
    """Returns a tower of rock that reaches past the ceiling."""
    return _rock(rng, rng.uniform(0.7, 1.15), rng.uniform(TALL + 1.0, 9.0), steepness=0.4)


def boulder(rng: np.random.Generator) -> Mesh:
    """Returns a boulder that stays below the flight level."""
    return _rock(rng, rng.uniform(0.8, 1.4), rng.uniform(1.2, 2.4))


def _rock(rng: np.random.Generator, wide: float, height: float, steepness: float = 1.0) -> Mesh:
    """A bumpy dome on the ground, or with a smaller ``steepness`` a tower that is as wide near its top as below."""
    rough = blob(rng, (wide, wide * rng.uniform(0.7, 1.0), 1.0), roughness=0.25)
    x, y, z = rough.vertices.T
    return Mesh(np.stack([x, y, np.where(z < 0, -ROOT * z, height * np.abs(z) ** steepness)], -1), rough.faces)


def mushroom(rng: np.random.Generator) -> Mesh:
    """Returns a wide cap of rock on a thin stem, at or above the flight level."""
    level, wide, thick = rng.uniform(3.6, 4.8), rng.uniform(0.9, 1.5), rng.uniform(0.8, 1.3)
    along = np.linspace(0, 1, 4)
    stem = tube(np.stack([np.zeros(4), _from_root(level, along)], -1), rng.uniform(0.2, 0.35) * np.linspace(1.4, 1, 4))
    cap = blob(rng, (wide, wide * rng.uniform(0.8, 1.0), thick), roughness=0.2)
    return Mesh.merge([stem, cap.translated((0.0, 0.0, level))])


def pole(rng: np.random.Generator) -> Mesh:
    """Returns a pole that leans by 5° to 30° and reaches past the ceiling."""
    girth, height = rng.uniform(0.12, 0.22), rng.uniform(TALL, 8.0)
    rise = _from_root(height, np.linspace(0, 1, 6))
    path = np.stack([rise * np.tan(np.radians(rng.uniform(5, 30))), rise], -1)
    return tube(path, np.linspace(1.2, 0.8, 6) * girth)


def arch(rng: np.random.Generator) -> Mesh:
    """Returns a stone arch whose crown hangs below, at or above the flight level."""
    half_span, top = rng.uniform(1.5, 2.3), rng.uniform(3.0, 6.5)
    angle = np.linspace(np.pi, 0, 13)
    path = np.stack([half_span * np.cos(angle), ROOT + (top - ROOT) * np.sin(angle) ** 0.8], -1)
    return tube(path, rng.uniform(0.25, 0.4) * (1 + 0.3 * np.abs(np.cos(angle))))


def overhang(rng: np.random.Generator) -> Mesh:
    """Returns a rock pillar that bends over and hangs out, below, at or above the flight level."""
    reach, height = rng.uniform(1.2, 2.0), rng.uniform(3.2, 6.0)
    along = np.linspace(0, np.pi / 2, 8)
    path = np.stack([reach * (1 - np.cos(along)), ROOT + (height - ROOT) * np.sin(along)], -1)
    return tube(path, rng.uniform(0.7, 0.95) * np.linspace(0.8, 0.5, 8), sides=9)


def bridge(rng: np.random.Generator) -> Mesh:
    """Returns a trunk that has fallen across two stumps of rock, at any height below the ceiling."""
    half_span, levels = rng.uniform(1.6, 2.6), rng.uniform(1.0, 4.6) + rng.uniform(-0.4, 0.4, 2)
    x = half_span * np.array([-1.25, -0.4, 0.4, 1.25])
    log = tube(np.stack([x, np.interp(x, (-half_span, half_span), levels)], -1), np.full(4, rng.uniform(0.2, 0.3)))
    parts = [log]
    for end, level in zip((-half_span, half_span), levels, strict=True):
        wide = rng.uniform(0.4, 0.6)
        parts.append(_rock(rng, wide, level + 0.2, steepness=0.5).translated((end, 0.0, 0.0)))
    return Mesh.merge(parts)


def buttress(rng: np.random.Generator) -> Mesh:
    """Returns a rib of rock that stands out from the wall behind it, which is at -x, and reaches past the ceiling."""
    reach, broad, top = rng.uniform(2.2, 4.5), rng.uniform(0.6, 1.1), rng.uniform(TALL, 7.5)
    rib = blob(rng, (reach, broad, 1.0), roughness=0.25)
    x, y, z = rib.vertices.T
    rise = np.where(z < 0, -ROOT * z, top * np.abs(z) ** 0.5)
    return Mesh(np.stack([np.where(x < 0, 0.1 * x, x), y, rise], -1), rib.faces)


def _from_root(height: float, along: np.ndarray) -> np.ndarray:
    """Heights from the root, below the ground, to ``height`` in m, at shares ``along`` of the way."""
    return ROOT + (height - ROOT) * along


_SHAPES = (tree, spire, pole, arch, overhang, mushroom, boulder, bridge, buttress)
KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {shape.__name__: shape for shape in _SHAPES}
# fmt: off
MIX = ("tree", "spire", "buttress", "pole", "mushroom", "spire", "arch",  # dealt out in this order
       "tree", "overhang", "spire", "tree", "boulder", "bridge")
# fmt: on


def make_obstacle(rng: np.random.Generator, kind: str, scale: float = 1.0, yaw: float | None = None) -> Mesh:
    """Returns one obstacle of the kind, all its lengths times ``scale``, its outline centred over the origin."""
    shape = KINDS[kind](rng)
    yaw = rng.uniform(0, 2 * np.pi) if yaw is None else yaw
    mesh = turned(Mesh(shape.vertices * scale, shape.faces), yaw)
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    return mesh.translated((-middle[0], -middle[1], 0.0))


def lowest_ground(ground: HeightField, xy: np.ndarray, radius: float) -> float:
    """Returns the least height of the ground within about ``radius`` of ``xy [2]``, so that nothing floats."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    return float(ground.at(np.concatenate([[xy], xy + rim / 2, xy + rim])).min())


def wall_places(rng: np.random.Generator, half: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns random points ``[count, 2]`` on a rectangle's border and the directions ``[count]`` inwards in rad."""
    along = rng.uniform(0, 2 * half.sum(), count)
    side, across = rng.choice((-1.0, 1.0), count), along < 2 * half[0]
    free = np.where(across, along - half[0], along - 2 * half[0] - half[1])
    places = np.where(across[:, None], np.stack([free, side * half[1]], -1), np.stack([side * half[0], free], -1))
    return places, np.where(across, -side * np.pi / 2, np.where(side > 0, np.pi, 0.0))


def place_obstacles(
    rng: np.random.Generator, count: int, scale: float, ground: HeightField, taken: np.ndarray | None = None
) -> list[Obstacle]:
    """Returns ``count`` obstacles on the ground from wall to wall; buttresses stand against the walls.

    They keep off the circles ``taken [K, 3]``, x, y and radius in m, where there is room.
    """
    half = np.maximum(np.array(ground.size) / 2 - MARGIN, 0.0)
    circles = np.zeros((0, 3)) if taken is None else taken
    obstacles = []
    for kind in (MIX[i % len(MIX)] for i in range(count)):
        mesh = make_obstacle(rng, kind, scale, 0.0)
        radius = float(np.linalg.norm(mesh.vertices[:, :2], axis=1).max())  # of its outline, seen from above
        if kind == "buttress":
            places, yaws = wall_places(rng, np.maximum(half + MARGIN - radius, 0.0), ATTEMPTS)
        else:
            places, yaws = rng.uniform(-half, half, (ATTEMPTS, 2)), rng.uniform(0, 2 * np.pi, ATTEMPTS)
        apart = np.linalg.norm(places[:, None] - circles[:, :2], axis=-1) - circles[:, 2] - radius
        chosen = int(np.minimum(apart.min(1, initial=np.inf), GAP).argmax())  # the first with a gap, or the roomiest
        x, y = places[chosen].tolist()
        mesh = turned(mesh, yaws[chosen])
        z = lowest_ground(ground, places[chosen], min(radius, FOOT))
        circles = np.concatenate([circles, [[x, y, radius]]])
        obstacles.append(Obstacle(kind, (x, y, z), radius, mesh.translated((x, y, z))))
    return obstacles
