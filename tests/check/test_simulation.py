"""The flying quadrotor follows every command."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from uavrl.envs.mesh import Mesh
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.simulation import Simulation

NO_DRAG = Aerodynamics(force_coefficients=(0.0, 0.0, 0.0), moment_coefficients=(0.0, 0.0, 0.0))
GRID = np.array(list(itertools.product((-2.0, -1.0, 0.0, 1.0, 2.0), repeat=4)))


@contextmanager
def world(count: int = 1, meshes: tuple[Mesh, ...] = (), spacing: float = 0.0, **settings) -> Iterator[Simulation]:
    """Vehicles at (0, spacing i, 3.5), heading along x."""
    simulation = Simulation(meshes, count, **settings)
    positions = np.arange(count)[:, None] * [0.0, spacing, 0.0] + [0.0, 0.0, 3.5]
    simulation.reset(np.arange(count), positions, np.zeros(count))
    try:
        yield simulation
    finally:
        simulation.close()


def seen(simulation: Simulation) -> np.ndarray:
    """Velocities in the yaw-aligned frame, and rate about the vertical: what the commands command."""
    cos, sin = np.cos(simulation.yaw), np.sin(simulation.yaw)
    x, y, z = simulation.velocity.T
    rate = (simulation.rotation[:, 2] * simulation.angular_velocity).sum(1)
    return np.stack([cos * x + sin * y, cos * y - sin * x, z, rate], axis=1)


@pytest.mark.parametrize(("lidar_mass", "tolerance"), [(0.83, 0.1), pytest.param(0.0, 0.11, marks=pytest.mark.slow)])
def test_every_command_is_tracked_within_ten_percent_after_one_and_a_half_seconds(lidar_mass, tolerance):
    with world(len(GRID), airframe=Airframe(lidar_mass=lidar_mass)) as simulation:
        for step in range(30):
            simulation.step(GRID)
            if step < 14:
                continue
            error = np.abs(seen(simulation) - GRID)
            straight = GRID[:, 3] == 0
            moving = np.abs(GRID) > 0
            relative = error / np.where(moving, np.abs(GRID), 1.0)
            assert relative[straight][moving[straight]].max() < 0.1
            assert error[straight][~moving[straight]].max() < 0.06
            # In a turn the velocity counts as one vector.
            speed = np.linalg.norm(GRID[:, :3], axis=1)
            assert (np.linalg.norm(error[:, :3], axis=1) <= tolerance * speed + 0.01 * (speed == 0)).all()
            assert (error[:, 3] < np.where(moving[:, 3], 0.1 * np.abs(GRID[:, 3]), 0.03)).all()
