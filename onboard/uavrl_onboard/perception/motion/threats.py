"""How near vehicles would come to moving objects, velocity by velocity."""

import numpy as np

from uavrl_onboard.perception.cells import grid_directions
from uavrl_onboard.perception.motion.sight import OBJECT
from uavrl_onboard.vehicle import VEHICLE

STEPS, PERIOD = 20, VEHICLE.period  # that are looked ahead, in s each: two seconds
TIMES = np.arange(1, STEPS + 1, dtype=np.float32) * np.float32(PERIOD)
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between
GREATEST = 2.2  # of threats
DIRECTIONS = grid_directions(24, (-0.5, 0.0, 0.5)).astype(np.float32)
"""In which a vehicle may fly, ``[72, 3]``: forward, left, up."""


def predict_path(commanded: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Where a vehicle will be ``[*B, T, 3]`` from here: its velocity follows the commanded one with a first-order lag.

    Args:
        commanded: velocities ``[*B, 3]`` in m/s.
        velocity: what it has now, likewise.

    Examples:
        >>> predict_path(np.array([2.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0]))[-1].round(6).tolist()
        [4.0, 0.0, 0.0]
    """
    times = TIMES.astype(commanded.dtype)
    lost = LAG * (1 - np.exp(-times / LAG))
    return commanded[..., None, :] * (times - lost)[:, None] + velocity[..., None, :] * lost[:, None]


def nearness(gap: np.ndarray) -> np.ndarray:
    """How near a body is at each time ``[*B, T]``, of what lies between ``[*B, T, 3]``; 0 is far, sooner counts more.

    Examples:
        >>> far, there = np.array([[0.0, 0.0, 9.0]] * STEPS), np.zeros((STEPS, 3))
        >>> bool(nearness(far).any()), nearness(there)[[0, -1]].round(2).tolist()
        (False, [1.16, 0.5])
    """
    return _nearness(_apart(gap))


def threat(gap: np.ndarray) -> np.ndarray:
    """How near one comes to a body and how soon ``[*B]``, of what lies between ``[*B, T, 3]``; 0 is far.

    Examples:
        >>> float(threat(np.full((STEPS, 3), 9.0)))
        0.0
    """
    apart = _apart(gap)
    return np.asarray(_nearness(apart).max(-1) + (apart < 1).any(-1))


def _apart(gap: np.ndarray) -> np.ndarray:
    """How far apart ``[*B, T]``, in units of what is too near."""
    level = (gap[..., 0] ** 2 + gap[..., 1] ** 2) ** 0.5
    return np.asarray(np.maximum(level / WIDE, np.abs(gap[..., 2]) / HIGH))


def _nearness(apart: np.ndarray) -> np.ndarray:
    """:func:`nearness` of what :func:`_apart` gives."""
    share = TIMES.astype(apart.dtype) / TIMES.astype(apart.dtype)[-1]
    return np.asarray((1.2 - 0.2 * share - apart).clip(0.0) * (1 - 0.5 * share))


def straight_on(objects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The ways ``[N, K, T, 3]`` of moving objects ``[N, K * 7]``, and which of them there are, ``bool [N, K]``.

    The objects are those that :class:`uavrl.transforms.MotionSight` reports.
    """
    each = objects.reshape(*objects.shape[:-1], -1, len(OBJECT))
    ways = each[..., None, :3] + each[..., None, 3:6] * TIMES[:, None]
    return ways, each[..., -1] > 0


def greatest_threats(commanded: np.ndarray, velocity: np.ndarray, ways: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The greatest threat of any body on each commanded velocity, ``[N, *D]``.

    Args:
        commanded: ``[N, *D, 3]`` in m/s, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    worst = np.zeros_like(commanded[..., 0])
    spread = [1] * (commanded.ndim - 2)
    for body in range(known.shape[-1]):
        which = np.flatnonzero(known[:, body])
        if len(which):
            path = predict_path(commanded[which], velocity[which].reshape(-1, *spread, 3))
            gap = path - ways[which, body].reshape(-1, *spread, *ways.shape[2:])
            worst[which] = np.maximum(worst[which], threat(gap))
    return worst
