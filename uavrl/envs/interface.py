"""What the environment takes and emits: actions, keys with their shapes and types, and the angles to the goal."""

import numpy as np
import torch
from torchrl.data import Binary, Composite, Unbounded

from uavrl.envs.simulation import Simulation
from uavrl.envs.vlp16 import NUM_RAYS
from uavrl.errors import UavrlError


def navigation_specs(n: int, device: torch.device, *, clearance: bool) -> tuple[Composite, Composite]:
    """The specs of the observations and of the ends of ``n`` vehicles."""

    def numbers(*shape: int, dtype: torch.dtype = torch.float32) -> Unbounded:
        return Unbounded(shape=(n, *shape), dtype=dtype, device=device)

    def flags(*keys: str) -> dict[str, Binary]:
        return {key: Binary(n=1, shape=(n, 1), dtype=torch.bool, device=device) for key in keys}

    observations = {
        "point_cloud": numbers(NUM_RAYS, 3),
        **{key: numbers(1) for key in ("altitude", "heading_deg", "elevation_deg", "distance")},
        **{key: numbers(3) for key in ("position", "velocity", "goal")},
        **flags("arrived", "collided"),
        **{key: numbers(1, dtype=torch.int64) for key in ("world_seed", "task")},
        **({"clearance": numbers(1)} if clearance else {}),
    }
    ends = Composite(flags("done", "terminated", "truncated"), shape=(n,), device=device)
    return Composite(observations, shape=(n,), device=device), ends


def quantities(simulation: Simulation, goal: np.ndarray, *, clearance: bool) -> dict[str, np.ndarray]:
    """What all vehicles emit of their motion and their goals ``[N, 3]``; the specs above name each.

    Altitude and heading are as the vehicles measure them, with their biases.
    """
    position, plants = simulation.position, simulation.plants
    found = {"position": position, "velocity": simulation.velocity, "goal": goal}
    found["altitude"] = position[:, 2] + plants.altitude_bias
    found["distance"] = goal_distance(position, goal)
    found["heading_deg"] = goal_heading_deg(position, simulation.yaw + plants.heading_bias, goal)
    found["elevation_deg"] = goal_elevation_deg(position, goal)
    return found | ({"clearance": simulation.closest_distance()} if clearance else {})


def checked_action(action: object, vehicles: int) -> np.ndarray:
    """The action of a policy as ``float64 [N, 4]``, or what it should have been."""
    if not isinstance(action, torch.Tensor) or action.shape != (vehicles, 4):
        came = tuple(action.shape) if isinstance(action, torch.Tensor) else type(action).__name__
        raise UavrlError(
            f"Expected an action of shape ({vehicles}, 4), one row (l_x, l_y, l_z, a_z) for each UAV, got {came}: "
            "check the policy's output."
        )
    if action.is_complex():
        raise UavrlError(f"Expected an action of real numbers, got {action.dtype}: check the policy's output.")
    return action.detach().to("cpu", torch.float64).numpy()


def wrap_degrees(angle: np.ndarray) -> np.ndarray:
    """An angle in radians as degrees in [0, 360), in float32."""
    degrees = (np.degrees(angle) % 360.0).astype(np.float32)
    return np.where(degrees < 360.0, degrees, np.float32(0.0))  # float32 rounds 360 - 1e-12 up to 360


def goal_distance(position: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The straight way to the goal, m."""
    return np.sqrt(((goal - position) ** 2).sum(1))


def goal_heading_deg(position: np.ndarray, yaw: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """H (§3.2): the horizontal angle from the UAV's head to the goal, degrees in [0, 360), left positive."""
    to_goal = goal - position
    return wrap_degrees(np.arctan2(to_goal[:, 1], to_goal[:, 0]) - yaw)


def goal_elevation_deg(position: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """G (§3.2): the elevation angle from the UAV's position to the goal, degrees in [0, 360)."""
    to_goal = goal - position
    return wrap_degrees(np.arctan2(to_goal[:, 2], np.hypot(to_goal[:, 0], to_goal[:, 1])))
