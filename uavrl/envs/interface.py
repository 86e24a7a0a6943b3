"""What the environment takes and emits: actions, and keys with their shapes and types."""

from collections.abc import Collection

import numpy as np
import torch
from torchrl.data import Binary, Composite, Unbounded

from uavrl.envs.privileged import QUANTITIES
from uavrl.envs.simulation import Simulation
from uavrl.errors import UavrlError
from uavrl_onboard.geometry import attitude_of
from uavrl_onboard.perception.goal import goal_distance, goal_elevation_deg, goal_heading_deg


def navigation_specs(
    n: int, rays: int, device: torch.device, *, clearance: bool, privileged: Collection[str] = ()
) -> tuple[Composite, Composite]:
    """The specs of the observations and of the ends of ``n`` vehicles, whose LiDARs have ``rays``."""

    def numbers(*shape: int, dtype: torch.dtype = torch.float32) -> Unbounded:
        return Unbounded(shape=(n, *shape), dtype=dtype, device=device)

    def flags(*keys: str) -> dict[str, Binary]:
        return {key: Binary(n=1, shape=(n, 1), dtype=torch.bool, device=device) for key in keys}

    observations = {
        "point_cloud": numbers(rays, 3),
        **{key: numbers(1) for key in ("altitude", "heading_deg", "elevation_deg", "distance")},
        **{key: numbers(3) for key in ("position", "velocity", "attitude", "goal")},
        **flags("arrived", "collided"),
        **{key: numbers(1, dtype=torch.int64) for key in ("world_seed", "task")},
        **({"clearance": numbers(1)} if clearance else {}),
        **{key: numbers(len(QUANTITIES[key].signs)) for key in privileged},
    }
    ends = Composite(flags("done", "terminated", "truncated"), shape=(n,), device=device)
    return Composite(observations, shape=(n,), device=device), ends


def quantities(simulation: Simulation, goal: np.ndarray, *, clearance: bool) -> dict[str, np.ndarray]:
    """What all vehicles emit of their motion and their goals ``[N, 3]``; the specs above name each.

    Altitude, heading and attitude are as the vehicles measure them, with their biases.
    """
    position, params = simulation.position, simulation.params
    found = {"position": position, "velocity": simulation.velocity, "goal": goal}
    yaw = simulation.yaw + params.heading_bias
    roll, pitch, _ = attitude_of(simulation.rotation).T
    found["attitude"] = np.stack([roll, pitch, (yaw + np.pi) % (2 * np.pi) - np.pi], -1)
    found["altitude"] = position[:, 2] + params.altitude_bias
    found["distance"] = goal_distance(position, goal)
    found["heading_deg"] = goal_heading_deg(position, yaw, goal)
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
