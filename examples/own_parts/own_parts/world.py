"""A world of your own: pillars on a grid, each moved a little at random."""

from dataclasses import dataclass

import numpy as np

from uavrl.envs.mesh import tube
from uavrl.envs.rules import Scene, Solid, WorldRules
from uavrl.envs.terrain import HeightField


@dataclass
class Pillars(WorldRules):
    """Pillars on level ground; ``spacing`` and ``radius`` are in m."""

    spacing: float = 4.0
    radius: float = 0.3

    def scene(self, number: int) -> Scene:
        """Return what there is in the place of ``seeds[number]``."""
        rng = np.random.default_rng(self.seeds[number])
        x, y = (np.arange(-length / 2, length / 2, self.spacing) + self.spacing / 2 for length in self.size)
        pillar = tube(np.array([[0.0, -0.5], [0.0, 2.0], [0.0, 4.5], [0.0, 7.0]]), np.full(4, self.radius))
        places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2) + rng.uniform(-1, 1, (len(x) * len(y), 2))
        pillars = [Solid("pillar", pillar.translated((*place, 0.0))) for place in places]
        return Scene(pillars, self.size, HeightField(np.zeros((2, 2)), self.size))
