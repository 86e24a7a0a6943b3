"""How near vehicles are to everything else."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from uavrl.envs.bullet import pybullet
from uavrl.envs.mesh import Mesh, cut_up, edge_lengths
from uavrl.envs.quadrotor import Airframe

CLOSEST_DISTANCE_CAP = 5.0  # m
SAMPLE_SPACING = 0.5  # m, at most, between samples of the surface
SLACK = 0.02  # m: Bullet's distances are right within its collision margins


def surface_samples(mesh: Mesh, spacing: float) -> np.ndarray:
    """The middles ``[P, 3]`` of a surface's triangles, cut up until no edge is over ``spacing``."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return cut_up(corners, lambda pieces: edge_lengths(pieces).max(axis=1) <= spacing).mean(axis=1)


class Clearance:
    """Distances from hulls to the bodies of a PyBullet world.

    Bullet looks at every triangle within the distance that it is asked for, so it is asked for no more than what the
    nearest sample of the static surface shows to be enough. The samples are made when they are first needed.
    """

    def __init__(self, client: int, statics: Sequence[Mesh], bodies: Sequence[int], airframe: Airframe) -> None:
        self._client, self._statics, self._bodies = client, list(statics), list(bodies)
        self._ball = min(airframe.collision_radius, airframe.collision_height / 2)  # in the middle of the hull

    @cached_property
    def _surface(self) -> cKDTree | None:
        return cKDTree(surface_samples(Mesh.merge(self._statics), SAMPLE_SPACING)) if self._statics else None

    def bounds(self, positions: np.ndarray) -> np.ndarray:
        """Returns ``[N]``: m, at most 5, within which the static geometry lies of hulls around ``positions [N, 3]``."""
        if self._surface is None:
            return np.full(len(positions), CLOSEST_DISTANCE_CAP)
        nearest = np.maximum(self._surface.query(positions)[0] - self._ball, 0.0)
        return np.minimum(nearest + SLACK, CLOSEST_DISTANCE_CAP)

    def distances(self, vehicles: Sequence[int], positions: np.ndarray) -> np.ndarray:
        """Returns ``[N]``: m from each hull to the nearest body, at most 5; below 0 inside."""
        distances = self.bounds(positions)
        for row, vehicle in enumerate(vehicles):
            for body in self._bodies:
                points = pybullet.getClosestPoints(
                    vehicle, body, distance=float(distances[row]), physicsClientId=self._client
                )
                distances[row] = min([distances[row], *(point[8] for point in points)])
        return distances
