"""The closest distance is the one that Bullet finds when it looks at everything within 5 m."""

from __future__ import annotations

import numpy as np
import pytest

from uavrl.envs.bullet import SAMPLE_SPACING, pybullet, surface_samples
from uavrl.envs.mesh import Mesh
from uavrl.envs.simulation import Simulation
from uavrl.envs.traffic import plane_mesh
from uavrl.envs.world import World, WorldConfig

UAVS, PLANES = 8, 3


def looked_at_everything(simulation: Simulation) -> np.ndarray:
    """Without any bound: all bodies, all triangles within 5 m."""
    found = np.full(simulation.count, 5.0)
    for row, vehicle in enumerate(simulation._vehicles):
        for body in simulation._statics + simulation._planes:
            points = pybullet.getClosestPoints(vehicle, body, 5.0, physicsClientId=simulation._client)
            found[row] = min([found[row], *(point[8] for point in points)])
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_the_closest_distance_is_that_of_looking_at_everything(seed: int) -> None:
    world, rng = World(WorldConfig(seeds=(seed,), size=(26.0, 20.0), obstacles=20)), np.random.default_rng(seed)
    simulation = Simulation(world.meshes, UAVS, plane_mesh=plane_mesh(2.0), plane_count=PLANES)
    found, expected = [], []
    for _ in range(15):
        places = rng.uniform([-12, -9, 0.3, -3], [12, 9, 9, 3], (UAVS + PLANES, 4))
        simulation.place_planes(places[UAVS:])
        simulation.reset(np.arange(UAVS), places[:UAVS, :3], places[:UAVS, 3])
        simulation.step(rng.uniform(-2, 2, (UAVS, 4)))  # tilts them
        found.append(simulation.closest_distance())
        expected.append(looked_at_everything(simulation))
    simulation.close()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert np.min(expected) < 0.0 < 1.5 < np.max(expected), "inside and far from things"


def test_a_plane_is_found_beyond_and_before_the_static_geometry() -> None:
    wall = Mesh([[4, -9, -9], [4, 9, -9], [4, 9, 9], [4, -9, 9]], [[0, 1, 2], [0, 2, 3]])  # the plane x = 4
    plane = plane_mesh(2.0)
    nose = float(plane.vertices[:, 0].max())
    for meshes, away, expected in (([wall], 3.0, 3.0 - 0.35), ([wall], 9.0, 4.0 - 0.35), ([], 9.0, 5.0)):
        simulation = Simulation(meshes, 1, plane_mesh=plane, plane_count=1)
        simulation.place_planes(np.array([[-away - nose, 0.0, 0.0, 0.0]]))
        assert simulation.closest_distance()[0] == pytest.approx(expected, abs=0.01)
        simulation.close()


def test_samples_lie_on_the_surface_and_leave_no_part_of_it_out() -> None:
    pole = Mesh([[0, 0, 0], [0.1, 0, 0], [0, 0, 9]], [[0, 1, 2]])
    samples = surface_samples(pole, SAMPLE_SPACING)
    assert not samples[:, 1].any() and (samples.min(0) >= 0).all()
    edge = np.stack([0 * np.arange(91), 0 * np.arange(91), np.arange(91) / 10], -1)
    assert np.linalg.norm(edge[:, None] - samples, axis=-1).min(1).max() < SAMPLE_SPACING
