"""The simulator flies what an autopilot is sent."""

from __future__ import annotations

import math

import numpy as np

from uavrl.envs.simulation import Simulation
from uavrl_onboard.autopilot.frames import swap_world, swap_yaw, to_command


def test_the_simulator_flies_a_command_as_an_autopilot_does() -> None:
    """An autopilot turns a command with its yaw; what comes out in its axes is what the simulator does in ours."""
    simulation = Simulation([], 1)
    try:
        compass, action = math.radians(30.0), np.array([1.0, 0.5, 0.25, 0.8])
        simulation.reset(np.array([0]), np.array([[0.0, 0.0, 50.0]]), np.array([swap_yaw(compass)]))
        start = simulation.position[0].copy()
        straight = np.array([*action[:3], 0.0])
        for _ in range(30):
            simulation.step(straight[None])
        flown = simulation.position[0] - start
        vx, vy, vz, _ = to_command(action)
        north, east = (
            math.cos(compass) * vx - math.sin(compass) * vy,
            math.sin(compass) * vx + math.cos(compass) * vy,
        )
        wanted = np.array(swap_world((north, east, vz)))
        np.testing.assert_allclose(flown / np.linalg.norm(flown), wanted / np.linalg.norm(wanted), atol=0.05)
        before = simulation.yaw[0]
        simulation.step(action[None])
        simulation.step(action[None])
        turned = math.remainder(swap_yaw(simulation.yaw[0]) - swap_yaw(before), math.tau)
        assert turned * to_command(action).yaw_rate > 0.0
    finally:
        simulation.close()
