"""The world: valleys of terrain and obstacles, and the tasks to fly in them."""

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from uavrl.envs.lanes import Lane, plan_lanes
from uavrl.envs.limits import OrMapping, require_finite, settings, whole
from uavrl.envs.obstacles import Obstacle, place_obstacles
from uavrl.envs.tasks import CELL, JITTER, FlightMap, Task, flight_map
from uavrl.envs.terrain import HeightField, interpolate, valley_ground
from uavrl.envs.traps import LONGEST_WAY, Trap, place_traps, trap_top, trapped
from uavrl.envs.valley_cache import ValleyMap, is_kept, is_writable, load_map, map_name, save_map
from uavrl.errors import UavrlError
from uavrl.runs.cache import valley_folder
from uavrl.runs.machine import processors
from uavrl_onboard.mesh import MOST_FACES, Mesh
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.vehicle import VEHICLE

log = logging.getLogger(__name__)
VALLEY_GAP = 110.0  # m between the borders of two valleys: over the LiDAR's range of 100 m
LANES = 12  # ways of planes through a valley
LARGEST_VALLEY = 200_000.0  # m³ up to the ceiling: building it takes 2.4 GB, and some 20 s
LARGEST_WORLD = 500_000.0  # m³ of all valleys together
MOST_OBSTACLES = 2000.0  # of a valley, each counted by its surface at scale 1
LARGEST = {
    "ceiling": 100.0,
    "goal_radius": 100.0,
    "min_clearance": 100.0,
    "uav_radius": 10.0,
    "traps": 20,
    "planes": 100,
    "plane_speed": 100.0,
    "plane_wingspan": 20.0,
}


def in_turn(counts: Iterable[int] | int) -> tuple[int, ...]:
    """The numbers that valleys take in turn, of which there may be one."""
    return (counts,) if isinstance(counts, int) else tuple(counts)


@dataclass
class WorldConfig:
    """Size, contents and rules of the world.

    Source: Chansuparp (2022), §4.1 and Table 4.1: 1200 m², random starts and goals, planes at a flight level of 3.5 m.

    Args:
        seeds: One valley per seed.
        size: Extent of a valley along x and y in m.
        obstacles: Number of obstacles per valley, or a list of numbers that the valleys take in turn.
        obstacle_scale: Factor on all lengths of the obstacles.
        traps: Number of traps per valley, walls as tall as the ceiling of which U, box canyon and a wall across the
            valley with one gap take turns. With any, every task leads into one: the straight line from start to goal
            meets its closed side from within, or that wall 3.5 m and more from its gap. The way around is at most 33 m
            long. Other obstacles stand elsewhere than without traps. There can be no planes.
        flight_level: Height in m (world z) at which episodes start.
        ceiling: Height above the ground in m at which an episode ends; the goal cylinder reaches up to it.
        goal_radius: Radius of the goal cylinder in m.
        min_goal_distance: Least horizontal distance from start to goal in m.
        min_clearance: Least distance in m from start and goal, at flight level, to the geometry.
        uav_radius: Radius in m of a ball around the UAV; corridors are wide enough for it.
        planes: Number of planes per valley; 3 in the thesis's dynamic environment.
        plane_speed: Least and greatest speed of a plane in m/s.
        plane_wingspan: Wingspan of a plane in m.
        plane_keep_out: Least distance in m from a start to a plane.
    """

    seeds: tuple[int, ...] = (0,)
    size: tuple[float, float] = (40.0, 30.0)
    obstacles: tuple[int, ...] | int = 45
    obstacle_scale: float = 1.0
    traps: int = 0
    flight_level: float = VEHICLE.flight_level
    ceiling: float = 5.0
    goal_radius: float = 1.0
    min_goal_distance: float = 10.0
    min_clearance: float = 1.5
    uav_radius: float = VEHICLE.radius
    planes: int = 0
    plane_speed: tuple[float, float] = (3.0, 4.0)
    plane_wingspan: float = 1.2
    plane_keep_out: float = 6.0

    def __post_init__(self) -> None:
        """Refuses values that make no world."""
        for name in ("seeds", "size", "plane_speed"):
            if not np.iterable(getattr(self, name)):
                raise UavrlError(f"{name} takes a list of numbers, got {getattr(self, name)!r}.")
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.seeds:
            raise ValueError("seeds takes one whole number per valley, got none; pass (0,) for one.")
        object.__setattr__(self, "seeds", tuple(whole("seeds", seed) for seed in self.seeds))
        require_finite(self, [field.name for field in fields(self) if field.name not in ("seeds", "obstacles")])
        if len(self.size) != 2:
            raise ValueError(f"size takes two lengths in metres, got {self.size}; pass (40.0, 30.0) for 1200 m².")
        positive = ("obstacle_scale", "flight_level", "ceiling", "goal_radius", "uav_radius")
        for name in (*positive, "plane_wingspan", "size", "plane_speed"):
            if not np.all(np.asarray(getattr(self, name)) > 0):
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}; give it in metres (or m/s).")
        if np.iterable(self.obstacles):
            object.__setattr__(self, "obstacles", tuple(whole("obstacles", count) for count in self.obstacles))
        else:
            object.__setattr__(self, "obstacles", whole("obstacles", self.obstacles))
        if not in_turn(self.obstacles):
            raise ValueError("obstacles takes a number, or a list that the valleys take in turn, got an empty list.")
        for name in ("planes", "traps"):
            object.__setattr__(self, name, whole(name, getattr(self, name)))
        if self.traps and self.planes:
            raise ValueError(f"planes have no lanes between traps, got {self.planes} and {self.traps}; set one to 0.")
        for name in ("min_goal_distance", "min_clearance", "plane_keep_out"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}; pass 0 to go without.")
        if len(self.plane_speed) != 2 or self.plane_speed[0] > self.plane_speed[1]:
            raise ValueError(
                f"plane_speed takes the least and the greatest speed, got {self.plane_speed}; pass (2.5, 4.0)."
            )
        if self.flight_level >= self.ceiling:
            raise ValueError(
                f"flight_level must be below the ceiling of {self.ceiling} m, got {self.flight_level} m; raise ceiling."
            )
        _check_size(self)

    def obstacles_of(self, place: int) -> int:
        """How many obstacles the valley at a place among ``seeds`` has."""
        counts = in_turn(self.obstacles)
        return counts[place % len(counts)]


def _check_size(world: WorldConfig) -> None:
    """Refuses worlds that would take many minutes to build, or more memory than there is."""
    for name, most in LARGEST.items():
        value = getattr(world, name)
        if (max(value) if isinstance(value, tuple) else value) > most:
            raise UavrlError(f"{name} must be at most {most:g}, got {value}; lower it.")
    valley = world.size[0] * world.size[1] * max(world.ceiling, 1.0)
    for volume, most, of in (
        (valley, LARGEST_VALLEY, "a valley"),
        (valley * len(world.seeds), LARGEST_WORLD, f"{len(world.seeds)} valleys together"),
    ):
        if volume > most:
            raise UavrlError(
                f"size and ceiling must make at most {most:,.0f} m³ of {of}, got {volume:,.0f} m³; lower size or "
                "ceiling, or give fewer seeds."
            )
    obstacles = max(in_turn(world.obstacles)) * max(1.0, world.obstacle_scale**2)
    if obstacles > MOST_OBSTACLES:
        raise UavrlError(
            f"obstacles must be at most {MOST_OBSTACLES:,.0f} in a valley, each counted obstacle_scale² times, got "
            f"{obstacles:,.0f}; lower obstacles or obstacle_scale."
        )


@dataclass(frozen=True)
class Valley:
    """One valley of the world; ``trapped`` has the tasks of each trap, which are all its tasks where there are any."""

    seed: int
    origin: np.ndarray
    config: WorldConfig
    ground: HeightField
    obstacles: list[Obstacle]
    candidates: np.ndarray  # [C, 2] m: where flights begin and end
    lanes: list[Lane]
    traps: list[Trap] = field(default_factory=list)
    trapped: list[np.ndarray] = field(default_factory=list)

    @cached_property
    def flight(self) -> FlightMap:
        """The map of its free space, which takes a second to make."""
        return _free_space(self.config, self.ground, self.obstacles)

    def meshes(self) -> list[Mesh]:
        """Returns its geometry in world coordinates, in few large parts: the physics steps faster over few bodies."""
        counts = [len(obstacle.mesh.faces) for obstacle in self.obstacles]
        bundle = np.repeat(np.cumsum(counts, dtype=int) // MOST_FACES, counts)  # whole obstacles
        parts = [*self.ground.tiles(), *Mesh.merge(obstacle.mesh for obstacle in self.obstacles).split(bundle)]
        return [part.translated((*self.origin, 0.0)) for part in parts]


def build_valley(config: WorldConfig, seed: int, origin: np.ndarray, count: int) -> Valley:
    """Builds one valley of ``count`` obstacles around ``origin [2]``; the cache may hold its map."""
    ground = valley_ground(np.random.default_rng([seed, 0]), config.size)
    traps = place_traps(np.random.default_rng([seed, 3]), config.traps, config.size)
    taken = np.concatenate([np.zeros((0, 3)), *(trap.taken() for trap in traps)])
    obstacles = place_obstacles(np.random.default_rng([seed, 1]), count, config.obstacle_scale, ground, taken)
    obstacles += [trap.obstacle(trap_top(config.ceiling)) for trap in traps]
    name = map_name(_rules(config, seed, count))
    if (found := load_map(name)) is None:
        found = _map_valley(config, seed, ground, obstacles, traps)
        save_map(name, found)
    return Valley(seed, origin, config, ground, obstacles, found.candidates, found.lanes, traps, found.trapped)


def _rules(config: WorldConfig, seed: int, count: int) -> dict[str, object]:
    """What the map of a valley depends on."""
    names = ("size", "obstacle_scale", "traps", "flight_level", "ceiling", "min_goal_distance", "min_clearance")
    rules = {name: getattr(config, name) for name in (*names, "uav_radius")}
    return {**rules, "wingspan": config.plane_wingspan if config.planes else 0.0, "seed": seed, "obstacles": count}


def _free_space(config: WorldConfig, ground: HeightField, obstacles: list[Obstacle]) -> FlightMap:
    return flight_map(
        ground,
        Mesh.merge(obstacle.mesh for obstacle in obstacles),
        level=config.flight_level,
        ceiling=config.ceiling,
        uav_radius=config.uav_radius,
        min_clearance=config.min_clearance,
        min_distance=config.min_goal_distance,
    )


def _map_valley(
    config: WorldConfig, seed: int, ground: HeightField, obstacles: list[Obstacle], traps: list[Trap]
) -> ValleyMap:
    """Finds where flights begin and end, the tasks of traps, and lanes for planes."""
    flight = _free_space(config, ground, obstacles)
    if not len(flight.candidates):
        raise UavrlError(
            f"A valley needs a start and a goal {config.min_goal_distance} m apart, {config.min_clearance} m clear of "
            f"geometry and joined by a free corridor, but seed {seed} has none in {config.size} m; enlarge size, or "
            "lower obstacles, obstacle_scale, min_clearance or min_goal_distance."
        )
    rng = np.random.default_rng([seed, 4])
    tasks = trapped(rng, flight, traps, config.flight_level, config.uav_radius, config.min_goal_distance)
    if traps and not tasks:
        raise UavrlError(
            f"A valley with traps needs a start and a goal between which one lies, joined by a way of at most "
            f"{LONGEST_WAY} m, but seed {seed} has none in {config.size} m; enlarge size, or lower obstacles."
        )
    lanes: list[Lane] = []
    if config.planes:
        rng, radius = np.random.default_rng([seed, 2]), config.plane_wingspan / 2
        top = float(np.ceil(ground.heights.max() + radius))
        solid = Mesh.merge([*ground.tiles(), *(obstacle.mesh for obstacle in obstacles)])
        lanes = plan_lanes(rng, solid, config.size, top, config.ceiling, radius, LANES)
    return ValleyMap(flight.candidates, lanes, tasks)


def _built(config: WorldConfig, places: Sequence[int]) -> Iterator[Valley]:
    """Builds the valleys at some places among ``config.seeds``, side by side; a command shows how far it is."""
    columns = int(np.ceil(len(config.seeds) ** 0.5))
    pitch = np.array(config.size) + VALLEY_GAP

    def build(i: int) -> Valley:
        return build_valley(config, config.seeds[i], pitch * divmod(i, columns), config.obstacles_of(i))

    new = len(_unknown(config, places))
    with ThreadPoolExecutor(processors()) as threads, _progress(new, len(places)) as line:  # NumPy releases the GIL
        for valley in threads.map(build, places):
            if line is not None:
                line.add()
            yield valley


def _unknown(config: WorldConfig, places: Sequence[int]) -> list[int]:
    """Those of some places among ``config.seeds`` whose maps the cache does not hold."""
    rules = {i: _rules(config, config.seeds[i], config.obstacles_of(i)) for i in places}
    return [i for i in places if not is_kept(map_name(rules[i]))]


def _progress(new: int, valleys: int) -> Any:
    """A progress line where a command builds several valleys that the cache does not hold."""
    if new < 2 or not log.isEnabledFor(logging.INFO):
        return nullcontext()
    from uavrl.runs.progress_line import ProgressLine  # here: it takes tqdm, without which environments fly, too

    log.info("Building %s, once: their maps are kept in %s.", pluralize(new, "valley"), valley_folder())
    return ProgressLine(valleys, "valleys", verb="building")


def map_valleys(config: WorldConfig) -> None:
    """Computes the maps that the cache does not hold, so that another process builds the world in seconds."""
    unknown = _unknown(config, range(len(config.seeds)))
    if unknown and is_writable():
        deque(_built(config, unknown), maxlen=0)


def draw_valley(config: WorldConfig, rng: np.random.Generator) -> int:
    """Draws a task's valley, the first thing that a task takes from its generator: its place among ``config.seeds``."""
    return int(rng.integers(len(config.seeds)))


class World:
    """All valleys side by side, out of each other's LiDAR range.

    Args:
        config: Size, contents and rules, or a dict of these.
        needed: Which of the valleys of ``config.seeds`` to build, by their places there; None for all. What is in them
            and where they lie does not depend on it.

    Attributes:
        valleys: Those that were built, in the order of ``config.seeds``.
        built: Their places among ``config.seeds``.

    Examples:
        >>> world = World(WorldConfig(seeds=(3,)))
        >>> task = world.sample_task(np.random.default_rng(0))
        >>> bool(np.linalg.norm(task.goal - task.start) >= 10.0), task.world_seed
        (True, 3)
        >>> world.arrived(task.goal[None] + [0.9, 0.0, 2.0], task.goal[None]).tolist()
        [True]
    """

    def __init__(self, config: OrMapping[WorldConfig], needed: Iterable[int] | None = None) -> None:
        self.config = config = settings("config", WorldConfig, config)
        self.built = sorted(set(range(len(config.seeds)) if needed is None else needed))
        self.valleys = list(_built(config, self.built))
        self.meshes = [mesh for valley in self.valleys for mesh in valley.meshes()]
        self._origins = np.stack([valley.origin for valley in self.valleys])
        self._heights = np.stack([valley.ground.heights for valley in self.valleys])

    def sample_task(self, rng: np.random.Generator, valley: int | None = None, avoid: np.ndarray | None = None) -> Task:
        """Draws a solvable task: a corridor, free in three dimensions for the UAV's radius, joins start and goal.

        Args:
            rng: Source of the task.
            valley: Index into ``valleys``; drawn if None.
            avoid: ``[K, 3]`` in metres: planes from which the start keeps ``plane_keep_out``. They move the start
                where they are too near; goal, valley and yaw depend on ``rng`` alone.

        Raises:
            UavrlError: If the planes leave no place to start, or the valley that is drawn was not built.
        """
        index = self._drawn(rng) if valley is None else valley
        place, config = self.valleys[index], self.config
        places = place.candidates
        if place.trapped:
            start, goal = places[rng.choice(place.trapped[rng.integers(len(place.trapped))])]
        else:
            start = places[rng.integers(len(places))]
            far = np.linalg.norm(places - start, axis=1) >= config.min_goal_distance + 2 * JITTER
            goal = places[rng.choice(np.flatnonzero(far))]
        start, goal = np.stack([start, goal]) + rng.uniform(-CELL / 2, CELL / 2, (2, 2)) + place.origin
        yaw = float(rng.uniform(-np.pi, np.pi))
        if avoid is not None and len(avoid):
            start = self._start_apart(rng, place, start, goal, np.asarray(avoid)[:, :2])
        middle = self.ground_height(goal[None])[0] + config.ceiling / 2
        return Task(np.append(start, config.flight_level), yaw, np.append(goal, middle), index, place.seed)

    def _drawn(self, rng: np.random.Generator) -> int:
        """Draws a valley, as an index into ``valleys``."""
        drawn = draw_valley(self.config, rng)
        if drawn not in self.built:
            raise UavrlError(
                f"The task is set in the valley of seed {self.config.seeds[drawn]}, which was not built: name the task "
                f"when the environment is made, or leave out tasks."
            )
        return self.built.index(drawn)

    def _start_apart(
        self, rng: np.random.Generator, place: Valley, start: np.ndarray, goal: np.ndarray, planes: np.ndarray
    ) -> np.ndarray:
        """The start, or another one far enough from the goal where a plane is too near to it."""
        keep_out = self.config.plane_keep_out
        if (np.linalg.norm(planes - start, axis=1) >= keep_out).all():
            return start
        places = place.candidates + place.origin
        apart = np.linalg.norm(places[:, None] - planes, axis=-1).min(1) >= keep_out
        far = np.linalg.norm(places - goal, axis=1) >= self.config.min_goal_distance
        if not (apart & far).any():
            raise UavrlError(
                f"A start needs {keep_out} m to {pluralize(len(planes), 'plane')}, but no free place of the valley of "
                f"seed {place.seed} has that; lower plane_keep_out or planes."
            )
        return places[rng.choice(np.flatnonzero(apart & far))]

    def ground_height(self, xy: np.ndarray) -> np.ndarray:
        """Returns the terrain's height ``[N]`` in metres at ``xy [N, 2]`` in the world, in the nearest valley."""
        nearest = np.linalg.norm(np.asarray(xy)[:, None] - self._origins, axis=-1).argmin(1)
        return interpolate(self._heights, self.config.size, nearest, xy - self._origins[nearest])

    def out_of_bounds(self, positions: np.ndarray, valley: np.ndarray) -> np.ndarray:
        """Returns which positions ``[N, 3]`` are over the ceiling or beyond the edge of ``valley [N]``, as bools."""
        local = positions[:, :2] - self._origins[valley]
        beyond = (np.abs(local) > np.array(self.config.size) / 2).any(1)
        ground = interpolate(self._heights, self.config.size, valley, local)
        return beyond | (positions[:, 2] > ground + self.config.ceiling)

    def arrived(self, positions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Returns which positions ``[N, 3]`` are in the cylinders around ``goals [N, 3]``: ``bool [N]``."""
        return np.linalg.norm((positions - goals)[:, :2], axis=1) <= self.config.goal_radius
