"""The valley, the world of the thesis: terrain with raised walls, obstacles, and traps if asked for."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavrl.envs.limits import require_finite, whole
from uavrl.envs.obstacles import place_obstacles
from uavrl.envs.rules import Scene, WorldRules, require_positive
from uavrl.envs.terrain import valley_ground
from uavrl.envs.traps import place_traps, trap_top
from uavrl.errors import UavrlError

MOST_OBSTACLES = 2000.0  # of a valley, each counted by its surface at scale 1


def in_turn(counts: Iterable[int] | int) -> tuple[int, ...]:
    """The numbers that valleys take in turn, of which there may be one."""
    return (counts,) if isinstance(counts, int) else tuple(counts)


def _turn(counts: tuple[int, ...] | int, number: int) -> int:
    """That of one valley."""
    taken = in_turn(counts)
    return taken[number % len(taken)]


@dataclass
class WorldConfig(WorldRules):
    """Size, contents and rules of a world of valleys.

    Source: Chansuparp (2022), §4.1 and Table 4.1: 1200 m², random starts and goals, planes at a flight level of 3.5 m.

    Args:
        obstacles: Number of obstacles per valley, or a list of numbers that the valleys take in turn.
        obstacle_scale: Factor on all lengths of the obstacles.
        traps: Number of traps per valley, or a list of numbers that the valleys take in turn. Traps are walls as tall
            as the ceiling of which U, box canyon and a wall across the valley with one gap take turns. In a valley with
            any, every task leads into one: the straight line from start to goal meets its closed side from within, or
            that wall 3.5 m and more from its gap. The way around is at most 33 m long. Other obstacles stand elsewhere
            than without traps. There can be no planes.
        **kwargs: As in :class:`uavrl.envs.rules.WorldRules`.
    """

    NAMED = False  # the default
    REMEDY = "enlarge size, or lower obstacles, obstacle_scale, min_clearance or min_goal_distance"

    obstacles: tuple[int, ...] | int = 45
    obstacle_scale: float = 1.0
    traps: tuple[int, ...] | int = 0

    def __post_init__(self) -> None:
        """Refuses values that make no valley."""
        for name in ("obstacles", "traps"):
            given = getattr(self, name)
            counts = tuple(whole(name, each) for each in given) if np.iterable(given) else whole(name, given)
            if counts == ():
                raise ValueError(f"{name} takes a number, or a list that the valleys take in turn, got an empty list.")
            object.__setattr__(self, name, counts)
        require_finite(self, ["obstacle_scale"])
        require_positive(self, "obstacle_scale")
        super().__post_init__()
        if any(in_turn(self.traps)) and self.planes:
            raise ValueError(f"planes have no lanes between traps, got {self.planes} and {self.traps}; set one to 0.")
        obstacles = max(in_turn(self.obstacles)) * max(1.0, self.obstacle_scale**2)
        if obstacles > MOST_OBSTACLES:
            raise UavrlError(
                f"obstacles must be at most {MOST_OBSTACLES:,.0f} in a valley, each counted obstacle_scale² times, got "
                f"{obstacles:,.0f}; lower obstacles or obstacle_scale."
            )

    def obstacles_of(self, number: int) -> int:
        """How many obstacles the valley of ``seeds[number]`` has."""
        return _turn(self.obstacles, number)

    def traps_of(self, number: int) -> int:
        """How many traps the valley of ``seeds[number]`` has."""
        return _turn(self.traps, number)

    def scene(self, number: int) -> Scene:
        """A valley around the origin."""
        seed = self.seeds[number]
        ground = valley_ground(np.random.default_rng([seed, 0]), self.size)
        traps = place_traps(np.random.default_rng([seed, 3]), self.traps_of(number), self.size)
        taken = np.concatenate([np.zeros((0, 3)), *(trap.taken() for trap in traps)])
        rng, count = np.random.default_rng([seed, 1]), self.obstacles_of(number)
        obstacles = place_obstacles(rng, count, self.obstacle_scale, ground, taken)
        obstacles += [trap.obstacle(trap_top(self.ceiling)) for trap in traps]
        return Scene(obstacles, self.size, ground, traps=traps, is_fine=True)

    def map_rules(self, number: int) -> dict[str, Any] | None:
        """What the map of a valley depends on; of a class of somebody's own its triangles have to tell."""
        if type(self) is not WorldConfig:
            return None
        own = {"obstacle_scale": self.obstacle_scale, "traps": self.traps_of(number)}
        return {**self.own_rules(), **own, "seed": self.seeds[number], "obstacles": self.obstacles_of(number)}
