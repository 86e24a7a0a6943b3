"""Where the goal lies, seen from the vehicle: distance and the two angles of the observation (§3.2), in numpy."""

import numpy as np


def wrap_degrees(angle: np.ndarray) -> np.ndarray:
    """An angle in radians as degrees in [0, 360), in float32."""
    degrees = (np.degrees(angle) % 360.0).astype(np.float32)
    return np.where(degrees < 360.0, degrees, np.float32(0.0))  # float32 rounds 360 - 1e-12 up to 360


def goal_distance(position: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The straight way to the goal, m."""
    with np.errstate(over="ignore"):  # a position that is no vehicle's is refused elsewhere
        return np.sqrt(((goal - position) ** 2).sum(1))


def goal_heading_deg(position: np.ndarray, yaw: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """H (§3.2): the horizontal angle from the UAV's head to the goal, degrees in [0, 360), left positive."""
    to_goal = goal - position
    return wrap_degrees(np.arctan2(to_goal[:, 1], to_goal[:, 0]) - yaw)


def goal_elevation_deg(position: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """G (§3.2): the elevation angle from the UAV's position to the goal, degrees in [0, 360)."""
    to_goal = goal - position
    return wrap_degrees(np.arctan2(to_goal[:, 2], np.hypot(to_goal[:, 0], to_goal[:, 1])))
