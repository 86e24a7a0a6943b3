"""The flying quadrotor follows every command."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.vehicles import GRID, seen, world
from uavrl.envs.quadrotor import Airframe


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


def test_ten_thousand_random_steps_stay_bounded():
    rng, count = np.random.default_rng(0), 16
    with world(count) as simulation:
        for _ in range(10_000 // count):
            simulation.step(rng.uniform(-2, 2, (count, 4)))
            assert np.isfinite(simulation.position).all()
            assert np.linalg.norm(simulation.velocity, axis=1).max() < 5.0
            assert np.abs(simulation.angular_velocity).max() < 15.0
            assert simulation.rotation[:, 2, 2].min() > 0.5  # never near its side
        assert np.abs(simulation.rotation @ simulation.rotation.transpose(0, 2, 1) - np.eye(3)).max() < 1e-9
