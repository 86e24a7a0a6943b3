"""Obstacles of the valley: trees, rocks, leaning poles, arches and overhangs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uavrl.envs.mesh import Mesh
from uavrl.envs.shapes import blob, tube, turned
from uavrl.envs.terrain import WALL_WIDTH, HeightField

ROOT = -1.2  # m: obstacles reach this far below the ground at their middle, so that none floats over a slope
GAP = 1.3  # m that the circles around two obstacles keep between them where there is room
ATTEMPTS = 40  # places tried for one obstacle before the roomiest of them is taken


@dataclass(frozen=True)
class Obstacle:
    """One obstacle in its valley's frame.

    Args:
        kind: A key of ``KINDS``.
        position: x, y and the ground's height under its middle, in metres.
        radius: Radius in metres of the circle around its outline seen from above.
        mesh: Its triangles: closed parts that may reach into each other.
    """

    kind: str
    position: tuple[float, float, float]
    radius: float
    mesh: Mesh


def tree(rng: np.random.Generator) -> Mesh:
    """Returns a trunk with a canopy around 4 m height.

    Examples:
        >>> bool(tree(np.random.default_rng(0)).vertices[:, 2].max() > 3.5)
        True
    """
    girth, height = rng.uniform(0.12, 0.22), rng.uniform(3.4, 4.4)
    lean, wide = rng.uniform(-0.3, 0.3), rng.uniform(0.45, 0.85)
    along = np.linspace(0, 1, 4)
    path = np.stack([lean * along**2, ROOT + (height - ROOT) * along], -1)
    trunk = tube(path, girth * (1.3 - 0.5 * along), sides=7)
    canopy = blob(rng, (wide, wide * rng.uniform(0.8, 1.1), rng.uniform(0.9, 1.5)), roughness=0.25)
    return Mesh.merge([trunk, canopy.translated((lean, 0.0, height))])


def rock(rng: np.random.Generator) -> Mesh:
    """Returns a boulder; most tower over the flight level, some stay below it.

    Examples:
        >>> len(rock(np.random.default_rng(0)).faces)
        320
    """
    wide, height = rng.uniform(0.75, 1.25), rng.uniform(3.0, 6.0)
    boulder = blob(rng, (wide, wide * rng.uniform(0.7, 1.0), height), roughness=0.25)
    x, y, z = boulder.vertices.T
    return Mesh(np.stack([x, y, np.where(z < 0, z * -ROOT / height, z)], -1), boulder.faces)


def pole(rng: np.random.Generator) -> Mesh:
    """Returns a pole that leans by 5° to 25°.

    Examples:
        >>> bool(pole(np.random.default_rng(0)).vertices[:, 2].max() > 3.5)
        True
    """
    girth, top = rng.uniform(0.1, 0.2), rng.uniform(4.8, 7.0)
    along = np.linspace(ROOT, top, 6)
    path = np.stack([along * np.tan(np.radians(rng.uniform(5, 25))), along], -1)
    return tube(path, np.linspace(1.2, 0.8, 6) * girth)


def arch(rng: np.random.Generator) -> Mesh:
    """Returns a stone arch with a passage wide enough for the UAV at 3.5 m.

    Examples:
        >>> bool(arch(np.random.default_rng(0)).vertices[:, 2].max() > 3.5)
        True
    """
    half_span, top = rng.uniform(1.5, 2.0), rng.uniform(5.0, 6.0)
    angle = np.linspace(np.pi, 0, 13)
    path = np.stack([half_span * np.cos(angle), ROOT + (top - ROOT) * np.sin(angle) ** 0.8], -1)
    return tube(path, rng.uniform(0.2, 0.35) * (1 + 0.3 * np.abs(np.cos(angle))))


def overhang(rng: np.random.Generator) -> Mesh:
    """Returns a rock pillar that bends over and hangs out at the flight level.

    Examples:
        >>> bool(overhang(np.random.default_rng(0)).vertices[:, 2].max() > 3.5)
        True
    """
    reach, height = rng.uniform(0.9, 1.5), rng.uniform(3.6, 4.4)
    along = np.linspace(0, np.pi / 2, 8)
    path = np.stack([reach * (1 - np.cos(along)), ROOT + (height - ROOT) * np.sin(along)], -1)
    return tube(path, rng.uniform(0.7, 0.95) * np.linspace(0.75, 0.4, 8), sides=9)


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "tree": tree,
    "rock": rock,
    "pole": pole,
    "arch": arch,
    "overhang": overhang,
}
MIX = ("tree", "rock", "pole", "arch", "tree", "rock", "overhang", "tree", "pole")  # dealt out in this order


def make_obstacle(rng: np.random.Generator, kind: str, scale: float = 1.0) -> Mesh:
    """Returns one obstacle of the kind with a random yaw, its outline centred over the origin.

    Args:
        rng: Source of sizes and yaw.
        kind: A key of ``KINDS``.
        scale: Factor on all its lengths.

    Examples:
        >>> mesh = make_obstacle(np.random.default_rng(0), "pole", scale=2.0)
        >>> bool(abs(mesh.vertices.min(0) + mesh.vertices.max(0))[:2].max() < 1e-5)
        True
    """
    shape = KINDS[kind](rng)
    mesh = turned(Mesh(shape.vertices * scale, shape.faces), rng.uniform(0, 2 * np.pi))
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    return mesh.translated((-middle[0], -middle[1], 0.0))


def outline_radius(mesh: Mesh) -> float:
    """Returns the radius in metres of the circle around the origin that holds the mesh seen from above.

    Examples:
        >>> outline_radius(Mesh(np.array([[3.0, 4, 9], [0, 0, 0], [1, 0, 0]]), np.array([[0, 1, 2]])))
        5.0
    """
    return float(np.linalg.norm(mesh.vertices[:, :2], axis=1).max())


def choose_place(rng: np.random.Generator, radius: float, circles: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Returns the first random place with ``GAP`` to all circles, or the roomiest of ``ATTEMPTS`` places.

    Args:
        rng: Source of the places.
        radius: Radius of the new circle in metres.
        circles: ``[K, 3]``: x, y and radius of what stands already, in metres.
        half: ``[2]``: places lie within ± this, in metres.

    Examples:
        >>> taken = np.array([[0.0, 0.0, 1.0]])
        >>> place = choose_place(np.random.default_rng(0), 1.0, taken, np.array([9.0, 9.0]))
        >>> bool(np.linalg.norm(place) >= 2.0 + GAP)
        True
    """
    places = rng.uniform(-half, half, size=(ATTEMPTS, 2))
    apart = np.linalg.norm(places[:, None] - circles[:, :2], axis=-1) - circles[:, 2] - radius
    room = np.minimum(apart.min(1, initial=np.inf), GAP)
    return places[room.argmax()]


def place_obstacles(rng: np.random.Generator, count: int, scale: float, ground: HeightField) -> list[Obstacle]:
    """Returns ``count`` obstacles on the ground between the walls.

    Args:
        rng: Source of sizes, yaws and places.
        count: Number of obstacles.
        scale: Factor on all their lengths.
        ground: The valley's height field.

    Examples:
        >>> flat = HeightField(np.zeros((2, 2)), (40.0, 30.0))
        >>> [o.kind for o in place_obstacles(np.random.default_rng(0), 4, 1.0, flat)]
        ['tree', 'rock', 'pole', 'arch']
    """
    half = np.maximum(np.array(ground.size) / 2 - WALL_WIDTH, 0.0)
    circles = np.zeros((0, 3))
    obstacles = []
    for kind in (MIX[i % len(MIX)] for i in range(count)):
        mesh = make_obstacle(rng, kind, scale)
        radius = outline_radius(mesh)
        x, y = choose_place(rng, radius, circles, half)
        z = float(ground.at(np.array([[x, y]]))[0])
        circles = np.concatenate([circles, [[x, y, radius]]])
        obstacles.append(Obstacle(kind, (float(x), float(y), z), radius, mesh.translated((x, y, z))))
    return obstacles
