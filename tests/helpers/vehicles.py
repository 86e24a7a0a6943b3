"""Vehicles in the physics alone, without a valley around them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from uavrl.envs.simulation import Simulation
from uavrl_onboard.mesh import Mesh

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
