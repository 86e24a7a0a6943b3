"""A building: rooms behind each other with doors between them, and a ceiling."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uavrl.envs.limits import require_finite
from uavrl.envs.rules import Scene, Solid, WorldRules, require_positive
from uavrl.envs.terrain import HeightField
from uavrl.envs.traps import wall
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

THICKNESS = 0.2  # m, of a wall
FOOT = -0.3  # m, of a wall
SLAB = 0.3  # m, thickness of the ceiling
ASIDE = 0.4  # m, least length of wall beside a door


@dataclass
class RoomsConfig(WorldRules):
    """A storey of rooms in a grid, each joined to others by doors, under a ceiling.

    Doors join all rooms: a random tree of doors, and further ones with the probability ``extra_doors``.

    Args:
        room: Length of a room's sides in m; the grid's are the nearest that divide ``size``.
        door_width: Least and greatest width of a door in m.
        door_height: Height of a door in m, at most that of the ceiling.
        extra_doors: Probability of a door where the tree has none.
        **kwargs: As in :class:`uavrl.envs.rules.WorldRules`; the building is ``ceiling`` m high.
    """

    REMEDY = "enlarge size, room or door_width, or lower min_clearance or min_goal_distance"

    ceiling: float = 5.5
    room: float = 6.0
    door_width: tuple[float, float] = (1.4, 2.2)
    door_height: float = 4.5
    extra_doors: float = 0.4

    def __post_init__(self) -> None:
        """Refuses values that make no building."""
        super().__post_init__()
        require_finite(self, ["room", "door_width", "door_height", "extra_doors"])
        require_positive(self, "room", "door_width", "door_height")
        if len(self.door_width) != 2 or self.door_width[0] > self.door_width[1]:
            raise UavrlError(f"door_width takes the least and the greatest width, got {self.door_width}.")
        if self.door_height > self.ceiling:
            raise UavrlError(f"door_height must be at most the ceiling's {self.ceiling} m, got {self.door_height} m.")
        if not 0 <= self.extra_doors <= 1:
            raise UavrlError(f"extra_doors must be a probability from 0 to 1, got {self.extra_doors}.")
        sides = [length / count for length, count in zip(self.size, self.grid, strict=True)]
        if min(sides) - THICKNESS < self.door_width[1] + 2 * ASIDE:
            raise UavrlError(
                f"A wall {min(sides):.1f} m long has no room for a door of {self.door_width[1]} m: enlarge room, or "
                "lower door_width."
            )
        if self.grid[0] * self.grid[1] > 400:
            raise UavrlError(f"size and room must make at most 400 rooms, got {self.grid[0] * self.grid[1]}.")

    @property
    def grid(self) -> tuple[int, int]:
        """Number of rooms along x and y."""
        across, along = (max(1, round(length / self.room)) for length in self.size)
        return across, along

    def scene(self, number: int) -> Scene:
        """A storey around the origin."""
        rng = np.random.default_rng([self.seeds[number], 1])
        x, y = (
            np.linspace(-length / 2, length / 2, count + 1) for length, count in zip(self.size, self.grid, strict=True)
        )
        doors, parts = _doors(rng, self.grid, self.extra_doors), []
        for i, j in np.ndindex(len(x), len(y)):
            if j < len(y) - 1:  # along y, between the rooms (i - 1, j) and (i, j)
                line = np.array([[x[i], y[j]], [x[i], y[j + 1]]])
                parts += self._wall(rng, line, ((i - 1, j), (i, j)) in doors)
            if i < len(x) - 1:
                line = np.array([[x[i], y[j]], [x[i + 1], y[j]]])
                parts += self._wall(rng, line, ((i, j - 1), (i, j)) in doors)
        length, width = self.size
        roof = np.array([[-length / 2, 0.0], [length / 2, 0.0]])
        slab = wall(roof, width, self.ceiling, self.ceiling + SLAB)
        ground = HeightField(np.zeros((2, 2)), self.size)
        return Scene([Solid("wall", Mesh.merge(parts)), Solid("ceiling", slab)], self.size, ground)

    def _wall(self, rng: np.random.Generator, line: np.ndarray, has_door: bool) -> list[Mesh]:
        """A wall along a line ``[2, 2]``, with or without a door somewhere in it."""
        if not has_door:
            return [wall(line, THICKNESS, FOOT, self.ceiling)]
        length = float(np.linalg.norm(line[1] - line[0]))
        wide = rng.uniform(*self.door_width)
        first = rng.uniform(ASIDE + THICKNESS / 2, length - wide - ASIDE - THICKNESS / 2)
        ends = np.array([0.0, first, first + wide, length]) / length
        corners = line[0] + ends[:, None] * (line[1] - line[0])
        left, door, right = (np.array(pair) for pair in pairwise(corners))
        inset = (door[1] - door[0]) / wide * THICKNESS / 2  # a wall is longer by half its thickness at each end
        sides = [np.array([left[0], left[1] - inset]), np.array([right[0] + inset, right[1]])]
        parts = [wall(side, THICKNESS, FOOT, self.ceiling) for side in sides]
        lintel = [wall(door, THICKNESS, self.door_height, self.ceiling)] if self.door_height < self.ceiling else []
        return parts + lintel


def _doors(
    rng: np.random.Generator, grid: tuple[int, int], extra: float
) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Between which rooms there are doors, the lower one first: so many that all are joined."""
    pairs = [((i, j), (i + 1, j)) for i in range(grid[0] - 1) for j in range(grid[1])]
    pairs += [((i, j), (i, j + 1)) for i in range(grid[0]) for j in range(grid[1] - 1)]
    part = {(i, j): i * grid[1] + j for i in range(grid[0]) for j in range(grid[1])}
    found = set()
    for index in rng.permutation(len(pairs)):
        one, other = pairs[index]
        old, new = part[one], part[other]
        if old != new or rng.random() < extra:
            found.add((one, other))
            part = {room: new if each == old else each for room, each in part.items()}
    return found
