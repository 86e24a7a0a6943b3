"""The most that a value may be where more has no sense: it would only keep the user waiting, or fill the memory."""

from typing import Any

from uavrl.configs.checks import require

MOST_OF_ALL = 1e15  # of any number: larger ones are slips, and overflow where they are used
MOST: dict[str, float] = {
    "env.num_uavs": 512,
    "env.max_steps": 1e6,
    "num_uavs": 512,
    "env.airframe.mass": 1e4,
    "env.airframe.inertia": 1e4,
    "env.airframe.arm": 10,
    "env.airframe.lidar_mass": 1e4,
    "env.airframe.lidar_position": 10,
    "env.airframe.lidar_diameter": 10,
    "env.airframe.lidar_height": 10,
    "env.airframe.max_total_thrust": 1e6,
    "env.airframe.thrust_coefficient": 1,
    "env.airframe.torque_to_thrust": 10,
    "env.airframe.motor_time_constant": 100,
    "env.aerodynamics.air_density": 1e3,
    "env.aerodynamics.force_coefficients": 1e3,
    "env.aerodynamics.moment_coefficients": 1e3,
    "env.aerodynamics.wind": 100,
    "env.aerodynamics.gust_intensity": 100,
    "env.aerodynamics.gust_time_constant": 1e6,
    "perception.radius": 100,  # the LiDAR's range
    "perception.lidar.max_range": 1e3,
    "perception.lidar.range_noise": 100,
    "perception.frames": 1000,
    "algo.policy_delay": 1e6,
    "algo.exploration_spread": 1e6,
    "algo.n_steps": 1e4,
    "collector.processes": 256,
    "collector.workers": 4096,
    "collector.steps_per_batch": 10_000,
    "trainer.updates_per_step": 100,
    "trainer.threads": 256,
    "threads": 256,
}


def check_most(key: str, value: Any) -> None:
    """Refuses a number above what its key may be, or below the negative of that."""
    most = MOST.get(key, MOST_OF_ALL)
    if isinstance(value, (int, float)) and abs(value) > most:
        side = f"at most {most:,.10g}" if value > 0 else f"at least {-most:,.10g}"
        require(False, key, side, value)
