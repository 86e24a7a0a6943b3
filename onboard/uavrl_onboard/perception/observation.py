"""The policy's observation and its state in numpy: what :mod:`uavrl.transforms` makes in training."""

from __future__ import annotations

from collections import deque
from typing import Literal, get_args

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.vehicle import VEHICLE

Angles = Literal["folded", "turns", "raw"]


def navigation_observation(
    cells: np.ndarray,
    altitude: float,
    heading_deg: float,
    elevation_deg: float,
    *,
    radius: float = 4.0,
    flight_level: float = VEHICLE.flight_level,
    angles: Angles = "folded",
) -> np.ndarray:
    """One observation, as `uavrl.transforms.observation.navigation_observation` scales it.

    Args:
        cells: ``[cells]``, what a reduction reports, in m.
        altitude: in m.
        heading_deg: the horizontal angle to the goal, left positive, in [0, 360) degrees
            (`uavrl_onboard.perception.goal.goal_heading_deg`).
        elevation_deg: the elevation angle to the goal, as well.
        radius: the ball's radius in m.
        flight_level: the altitude at which the observation's altitude is 0, in m.
        angles: ``"folded"``, ``"turns"`` or ``"raw"``.

    Returns:
        ``float32 [cells + 3]``.

    Examples:
        >>> navigation_observation(np.full(32, 2.0), 7.0, 270.0, 45.0)[-4:].tolist()
        [0.5, 1.0, -0.5, 0.25]
    """
    if angles not in get_args(Angles):
        raise UavrlError(f"angles must be one of {', '.join(get_args(Angles))}, got {angles!r}.")
    turned = np.array([heading_deg, elevation_deg], np.float32)
    if angles == "folded":
        turned[:] = (turned + 180) % 360 / 180 - 1
    elif angles == "turns":
        turned /= 360
    scaled = np.asarray(cells, np.float32) / radius
    return np.concatenate([scaled, [np.float32(altitude) / flight_level - 1], turned]).astype(np.float32)


class FrameStack:
    """The last observations in a row, oldest first, zeros before the first: what a policy reads.

    Args:
        frames: observations in a state.
        last_action: whether each observation also holds the action that led to it, divided by ``action_limit``.
        action_limit: what a network reads as 1: m/s for the three velocities, rad/s for the yaw rate.

    Examples:
        >>> state = FrameStack(frames=3)
        >>> state(np.ones(2)).tolist(), state(np.full(2, 5.0)).tolist()
        ([0.0, 0.0, 0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 1.0, 5.0, 5.0])
    """

    def __init__(
        self, frames: int = 3, last_action: bool = False, action_limit: float = VEHICLE.velocity_limit
    ) -> None:
        self.frames, self.last_action, self.action_limit = frames, last_action, action_limit
        self._past: deque[np.ndarray] = deque(maxlen=frames)

    def reset(self) -> None:
        """Forgets all observations, as at the beginning of an episode."""
        self._past.clear()

    def __call__(self, observation: np.ndarray, action: np.ndarray | None = None) -> np.ndarray:
        """Adds an observation and the action that led to it (None: none has), and returns ``float32 [state]``."""
        if self.last_action:
            scaled = np.zeros(4) if action is None else np.asarray(action) / self.action_limit
            observation = np.concatenate([observation, scaled])
        self._past.append(np.asarray(observation, np.float32))
        missing = [np.zeros_like(self._past[-1])] * (self.frames - len(self._past))
        return np.concatenate([*missing, *self._past])
