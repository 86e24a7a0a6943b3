"""A world: places of terrain and obstacles side by side, and the tasks to fly in them."""

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from uavrl.envs.limits import settings
from uavrl.envs.place import Place, build_place
from uavrl.envs.rules import WorldRules
from uavrl.envs.tasks import CELL, JITTER, Task
from uavrl.envs.terrain import interpolate
from uavrl.envs.valley import WorldConfig
from uavrl.envs.valley_cache import is_kept, is_writable, map_name
from uavrl.errors import UavrlError
from uavrl.runs.cache import valley_folder
from uavrl.runs.machine import processors
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)
PLACE_GAP = 110.0  # m between the borders of two places: over the LiDAR's range of 100 m
CROWDED = 2 / 3  # of plane_keep_out, which a start has at least where planes leave no more for a moment


if TYPE_CHECKING:
    WorldLike: TypeAlias = WorldRules | Mapping[str, Any]
else:
    WorldLike = WorldConfig  # which a yaml file is validated against where it names no other class


def world_rules(given: WorldLike | None) -> WorldRules:
    """The settings of a world: those given, of any kind of world, or those of valleys that a dict names."""
    return given if isinstance(given, WorldRules) else settings("world", WorldConfig, given)


def _built(config: WorldRules, numbers: Sequence[int]) -> Iterator[Place]:
    """Builds the places of some of ``config.seeds``, side by side; a command shows how far it is."""
    columns = int(np.ceil(len(config.seeds) ** 0.5))

    def build(number: int) -> Place:
        return build_place(config, number, config.pitch(PLACE_GAP) * divmod(number, columns))

    new = len(_unknown(config, numbers))
    with ThreadPoolExecutor(processors()) as threads, _progress(new, len(numbers)) as line:  # NumPy releases the GIL
        for place in threads.map(build, numbers):
            if line is not None:
                line.add()
            yield place


def _unknown(config: WorldRules, numbers: Sequence[int]) -> list[int]:
    """Those of some places whose maps the cache does not hold, as far as can be told without building them."""
    rules = {number: config.map_rules(number) for number in numbers}
    return [n for n, each in rules.items() if each is None or not is_kept(map_name(each))]


def _progress(new: int, places: int) -> Any:
    """A progress line where a command builds several places that the cache may not hold."""
    if new < 2 or not log.isEnabledFor(logging.INFO):
        return nullcontext()
    from uavrl.runs.progress_line import ProgressLine  # here: it takes tqdm, without which environments fly, too

    log.info("Building %s, once: their maps are kept in %s.", pluralize(new, "valley"), valley_folder())
    return ProgressLine(places, "valleys", verb="building")


def map_places(config: WorldRules, numbers: Sequence[int] | None = None) -> None:
    """Computes the maps that the cache does not hold, so that another process builds the world in seconds.

    Args:
        config: of the world.
        numbers: of its places, among ``config.seeds``; None: all.
    """
    unknown = _unknown(config, range(len(config.seeds)) if numbers is None else numbers)
    if unknown and is_writable():
        deque(_built(config, unknown), maxlen=0)


def draw_place(config: WorldRules, rng: np.random.Generator) -> int:
    """Draws a task's place, the first thing that a task takes from its generator: its number among ``config.seeds``."""
    return int(rng.integers(len(config.seeds)))


def task_rng(seed: int, task: int) -> np.random.Generator:
    """The generator that draws a task of a seed."""
    return np.random.default_rng((seed, task))


def places_of(config: WorldRules, seed: int, tasks: Iterable[int]) -> list[int]:
    """The places of tasks: their numbers among ``config.seeds``."""
    return [draw_place(config, task_rng(seed, task)) for task in tasks]


class World:
    """All places side by side, out of each other's LiDAR range.

    Args:
        config: Size, contents and rules: of valleys, or of any other kind of world; or a dict of those of valleys.
        needed: Which of the places of ``config.seeds`` to build, by their numbers there; None for all. What is in them
            and where they lie does not depend on it.

    Attributes:
        places: Those that were built, in the order of ``config.seeds``.
        built: Their numbers among ``config.seeds``.

    Examples:
        >>> world = World(WorldConfig(seeds=(3,)))
        >>> task = world.sample_task(np.random.default_rng(0))
        >>> bool(np.linalg.norm(task.goal - task.start) >= 10.0), task.world_seed
        (True, 3)
        >>> world.arrived(task.goal[None] + [0.9, 0.0, 2.0], task.goal[None]).tolist()
        [True]
    """

    def __init__(self, config: WorldLike, needed: Iterable[int] | None = None) -> None:
        self.config = config = world_rules(config)
        self.built = sorted(set(range(len(config.seeds)) if needed is None else needed))
        self.places = list(_built(config, self.built))
        self.meshes = [mesh for place in self.places for mesh in place.meshes()]
        self._origins = np.stack([place.origin for place in self.places])
        floors = [place.floor for place in self.places]
        self._heights, self._sizes = np.stack([floor.heights for floor in floors]), np.array([f.size for f in floors])

    def sample_task(self, rng: np.random.Generator, place: int | None = None, avoid: np.ndarray | None = None) -> Task:
        """Draws a solvable task: a corridor, free in three dimensions for the UAV's radius, joins start and goal.

        Args:
            rng: Source of the task.
            place: Index into ``places``; drawn if None.
            avoid: ``[K, 3]`` in metres: planes from which the start keeps ``plane_keep_out``. They move the start
                where they are too near; goal, place and yaw depend on ``rng`` alone.

        Raises:
            UavrlError: If the planes leave no place to start, or the place that is drawn was not built.
        """
        index = self._drawn(rng) if place is None else place
        here, config = self.places[index], self.config
        places = here.candidates
        if here.trapped:
            start, goal = places[rng.choice(here.trapped[rng.integers(len(here.trapped))])]
        else:
            start = places[rng.integers(len(places))]
            far = np.linalg.norm(places - start, axis=1) >= config.min_goal_distance + 2 * JITTER
            goal = places[rng.choice(np.flatnonzero(far))]
        start, goal = np.stack([start, goal]) + rng.uniform(-CELL / 2, CELL / 2, (2, 2)) + here.origin
        yaw = float(rng.uniform(-np.pi, np.pi))
        if avoid is not None and len(avoid):
            start = self._start_apart(rng, here, start, goal, np.asarray(avoid)[:, :2])
        middle = self.ground_height(goal[None])[0] + config.ceiling / 2
        return Task(np.append(start, config.flight_level), yaw, np.append(goal, middle), index, here.seed)

    def _drawn(self, rng: np.random.Generator) -> int:
        """Draws a place, as an index into ``places``."""
        drawn = draw_place(self.config, rng)
        if drawn not in self.built:
            raise UavrlError(
                f"The task is set in the valley of seed {self.config.seeds[drawn]}, which was not built: name the task "
                f"when the environment is made, or leave out tasks."
            )
        return self.built.index(drawn)

    def _start_apart(
        self, rng: np.random.Generator, place: Place, start: np.ndarray, goal: np.ndarray, planes: np.ndarray
    ) -> np.ndarray:
        """The start, or another one far enough from the goal where a plane is too near to it.

        Where the planes are near all of these for a moment, it is the one that they leave most room, if not too little.
        """
        keep_out = self.config.plane_keep_out
        if (np.linalg.norm(planes - start, axis=1) >= keep_out).all():
            return start
        places = place.candidates + place.origin
        places = places[np.linalg.norm(places - goal, axis=1) >= self.config.min_goal_distance]
        room = np.linalg.norm(places[:, None] - planes, axis=-1).min(1)
        if (room >= keep_out).any():
            return places[rng.choice(np.flatnonzero(room >= keep_out))]
        if room.max(initial=0.0) < CROWDED * keep_out:
            raise UavrlError(
                f"A start needs {keep_out} m to {pluralize(len(planes), 'plane')}, but no free place of the valley of "
                f"seed {place.seed} has even {CROWDED:.0%} of that; lower plane_keep_out or planes."
            )
        return places[room.argmax()]

    def ground_height(self, xy: np.ndarray) -> np.ndarray:
        """Returns the floor's height ``[N]`` in metres at ``xy [N, 2]`` in the world, in the nearest place."""
        nearest = np.linalg.norm(np.asarray(xy)[:, None] - self._origins, axis=-1).argmin(1)
        return interpolate(self._heights, self._sizes[nearest], nearest, xy - self._origins[nearest])

    def out_of_bounds(self, positions: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Returns which positions ``[N, 3]`` are over the ceiling, beyond the edge or below ``place [N]``."""
        local = positions[:, :2] - self._origins[place]
        beyond = (np.abs(local) > self._sizes[place] / 2).any(1)
        ground = interpolate(self._heights, self._sizes[place], place, local)
        return beyond | (positions[:, 2] > ground + self.config.ceiling) | (positions[:, 2] < ground)

    def arrived(self, positions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Returns which positions ``[N, 3]`` are in the cylinders around ``goals [N, 3]``: ``bool [N]``."""
        return np.linalg.norm((positions - goals)[:, :2], axis=1) <= self.config.goal_radius
