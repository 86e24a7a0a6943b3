"""One place of a world: its triangles, its free space, its tasks and its bounds, whatever kind of world it is of."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uavrl.envs.lanes import Lane, plan_lanes
from uavrl.envs.mesh import cut_up, edge_lengths
from uavrl.envs.rules import Scene, Standing, WorldRules
from uavrl.envs.scene_check import checked_scene
from uavrl.envs.tasks import FlightMap, flight_map
from uavrl.envs.terrain import HeightField
from uavrl.envs.traps import LONGEST_WAY, Trap, trapped
from uavrl.envs.valley_cache import ValleyMap, load_map, map_name, save_map
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import MOST_FACES, Mesh

LANES = 12  # ways of planes through a place
PIECE = 0.5  # m, longest edge of the pieces of triangles of which the free space is measured
NEAR = 3.0  # m around the area of a place within which geometry bears on its free space
TILE = 8.0  # m, side of the squares by which a large mesh is cut up for the physics


@dataclass(frozen=True)
class Place:
    """One place; ``trapped`` has the tasks of each trap, which are all its tasks where there are any."""

    seed: int
    origin: np.ndarray
    config: WorldRules
    scene: Scene
    candidates: np.ndarray  # [C, 2] m: where flights begin and end
    lanes: list[Lane]
    trapped: list[np.ndarray]
    fits: np.ndarray  # bool [X, Y]: where on a grid at the flight level a vehicle fits and is free
    corner: np.ndarray  # [2] m: the grid's first point

    @property
    def size(self) -> tuple[float, float]:
        """Lengths along x and y, in m, of the area in which episodes begin and end."""
        return self.scene.size

    @property
    def ground(self) -> HeightField | None:
        """The ground; None where the obstacles hold it."""
        return self.scene.ground

    @property
    def obstacles(self) -> Sequence[Standing]:
        """All that stands there."""
        return self.scene.obstacles

    @property
    def traps(self) -> Sequence[Trap]:
        """Those of a valley."""
        return self.scene.traps

    @property
    def floor(self) -> HeightField:
        """The ground, or a level at 0 where the obstacles hold it."""
        return _floor(self.scene)

    def meshes(self) -> list[Mesh]:
        """Returns its geometry in world coordinates, in few large parts: the physics steps faster over few bodies."""
        counts = [len(obstacle.mesh.faces) for obstacle in self.obstacles]
        merged = Mesh.merge(obstacle.mesh for obstacle in self.obstacles)
        if max(counts, default=0) > MOST_FACES:
            bundle = _tiles(merged)
        else:
            bundle = np.repeat(np.cumsum(counts, dtype=int) // MOST_FACES, counts)  # whole obstacles
        parts = [*([] if self.ground is None else self.ground.tiles()), *merged.split(bundle)]
        return [part.translated((*self.origin, 0.0)) for part in parts]


def _tiles(mesh: Mesh) -> np.ndarray:
    """Parts of a large mesh, each of neighbours: an index for each face."""
    middles = mesh.vertices[mesh.faces].mean(1)
    column, row = np.floor(middles[:, :2] / TILE).astype(np.int64).T
    part = np.empty(len(middles), np.int64)
    part[np.lexsort((np.where(column % 2, -row, row), column))] = np.arange(len(middles)) // MOST_FACES
    return part


def _floor(scene: Scene) -> HeightField:
    if scene.ground is not None:
        return scene.ground
    return HeightField(np.zeros((2, 2)), (scene.size[0] + 2 * scene.margin, scene.size[1] + 2 * scene.margin))


def build_place(config: WorldRules, number: int, origin: np.ndarray) -> Place:
    """Builds the place of ``config.seeds[number]`` around ``origin [2]``; the cache may hold its map."""
    scene = checked_scene(config, number)
    rules = config.map_rules(number)
    name = map_name({**config.own_rules(), "scene": _digest(scene)} if rules is None else rules)
    if (found := load_map(name)) is None:
        found = _map_place(config, config.seeds[number], scene)
        save_map(name, found)
    return Place(config.seeds[number], origin, config, scene, *found)


def _digest(scene: Scene) -> str:
    """A hash of all triangles and of the bounds."""
    digest = hashlib.sha256(repr((scene.size, scene.margin)).encode())
    for part in ([] if scene.ground is None else scene.ground.tiles()) + [each.mesh for each in scene.obstacles]:
        digest.update(part.vertices.tobytes() + part.faces.tobytes())
    return digest.hexdigest()


def free_space(config: WorldRules, scene: Scene) -> FlightMap:
    """Map the free space of a scene, which takes a second or two."""
    return flight_map(
        _floor(scene),
        measured_surface(scene),
        size=scene.size,
        level=config.flight_level,
        ceiling=config.ceiling,
        uav_radius=config.uav_radius,
        min_clearance=config.min_clearance,
        min_distance=config.min_goal_distance,
    )


def triangles_of(scene: Scene) -> Mesh:
    """All triangles of a scene, those of the ground first."""
    ground = [] if scene.ground is None else scene.ground.tiles()
    return Mesh.merge([*ground, *(obstacle.mesh for obstacle in scene.obstacles)])


def measured_surface(scene: Scene) -> Mesh:
    """The triangles that bear on a scene's free space, as distances to them are measured."""
    return triangles_of(scene) if scene.is_fine else _cut(triangles_of(scene), scene.size)


def _cut(mesh: Mesh, size: tuple[float, float]) -> Mesh:
    """The triangles near an area, in pieces without long edges, which would take many points each."""
    half = np.array(size) / 2 + NEAR

    def done(pieces: np.ndarray) -> np.ndarray:
        flat = pieces[..., :2]
        outside = ((flat.max(1) < -half) | (flat.min(1) > half)).any(1)
        return outside | (edge_lengths(pieces).max(1) <= PIECE)

    pieces = cut_up(mesh.vertices[mesh.faces].astype(np.float64), done)
    flat = pieces[..., :2]
    pieces = pieces[((flat.max(1) >= -half) & (flat.min(1) <= half)).all(1)]
    return Mesh(pieces.reshape(-1, 3), np.arange(3 * len(pieces)).reshape(-1, 3))


def _map_place(config: WorldRules, seed: int, scene: Scene) -> ValleyMap:
    """Finds where flights begin and end, the tasks of traps, and lanes for planes."""
    flight = free_space(config, scene)
    if not len(flight.candidates):
        raise UavrlError(config.without_tasks(seed, scene, flight.area_at(config.flight_level)))
    rng = np.random.default_rng([seed, 4])
    traps = list(scene.traps)
    tasks = trapped(rng, flight, traps, config.flight_level, config.uav_radius, config.min_goal_distance)
    if traps and not tasks:
        raise UavrlError(
            f"A valley with traps needs a start and a goal between which one lies, joined by a way of at most "
            f"{LONGEST_WAY} m, but seed {seed} has none in {scene.size} m; enlarge size, or lower obstacles."
        )
    lanes: list[Lane] = []
    if config.planes:
        rng, radius = np.random.default_rng([seed, 2]), config.plane_wingspan / 2
        top = float(np.ceil(_floor(scene).heights.max() + radius))
        lanes = plan_lanes(rng, triangles_of(scene), scene.size, top, config.ceiling, radius, LANES)
    fits = flight.corridor[:, :, flight.at(config.flight_level)]
    corner = np.array([flight.space.x[0], flight.space.y[0]], np.float64)
    return ValleyMap(flight.candidates, lanes, tasks, fits, corner)
