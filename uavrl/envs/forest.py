"""A forest: vertical trunks on level ground, by their density."""

from dataclasses import dataclass

import numpy as np

from uavrl.envs.limits import require_finite
from uavrl.envs.mesh import tube
from uavrl.envs.rules import Scene, Solid, WorldRules, require_positive
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

MARGIN = 8.0  # m of forest around the area of the tasks: a way around a trunk may leave it
ROOT = -0.5  # m, foot of a trunk
OVER = (1.5, 3.0)  # m that a trunk rises over the ceiling
MOST_TREES = 3000
SIDES = 8  # of a trunk
SECTION = 1.0  # m, length of its parts: short triangles are cheap to look at


@dataclass
class ForestConfig(WorldRules):
    """A forest of vertical trunks that reach past the ceiling.

    Trunks stand at random places, as in Loquercio et al. (2021), "Learning high-speed flight in the wild". The forest
    goes on for 8 m around the area in which episodes begin and end.

    Args:
        density: Trees per hectare.
        trunk_radius: Least and greatest radius of a trunk in m.
        **kwargs: As in :class:`uavrl.envs.rules.WorldRules`.
    """

    REMEDY = "enlarge size, or lower density, trunk_radius, min_clearance or min_goal_distance"

    density: float = 400.0
    trunk_radius: tuple[float, float] = (0.15, 0.35)

    def __post_init__(self) -> None:
        """Refuses values that make no forest."""
        super().__post_init__()
        require_finite(self, ["density", "trunk_radius"])
        require_positive(self, "density", "trunk_radius")
        if len(self.trunk_radius) != 2 or self.trunk_radius[0] > self.trunk_radius[1]:
            raise UavrlError(
                f"trunk_radius takes the least and the greatest radius, got {self.trunk_radius}; pass (0.15, 0.35)."
            )
        if self.trees > MOST_TREES:
            raise UavrlError(f"density and size must make at most {MOST_TREES:,} trees, got {self.trees:,}; lower one.")

    @property
    def trees(self) -> int:
        """How many trees there are in a place, those around it included."""
        length, width = self.pitch(0.0)
        return round(self.density * length * width / 1e4)

    def pitch(self, gap: float) -> np.ndarray:
        """As of any world, with the forest around."""
        return np.array(self.size) + 2 * MARGIN + gap

    def scene(self, number: int) -> Scene:
        """A forest around the origin."""
        rng, extent = np.random.default_rng([self.seeds[number], 1]), self.pitch(0.0)
        places = rng.uniform(-0.5, 0.5, (self.trees, 2)) * extent
        radii, over = rng.uniform(*self.trunk_radius, self.trees), rng.uniform(*OVER, self.trees)
        trunks = [
            _trunk(self.ceiling + top, radius).translated((x, y, 0.0))
            for (x, y), radius, top in zip(places, radii, over, strict=True)
        ]
        ground = HeightField(np.zeros((2, 2)), (float(extent[0]), float(extent[1])))
        return Scene([Solid("tree", Mesh.merge(trunks))], self.size, ground, MARGIN)


def _trunk(top: float, radius: float) -> Mesh:
    heights = np.linspace(ROOT, top, int(np.ceil((top - ROOT) / SECTION)) + 1)
    return tube(np.column_stack([np.zeros(len(heights)), heights]), np.full(len(heights), radius), SIDES)
