"""Where a vehicle would meet moving objects, direction by direction, if they fly straight on.

The functions take arrays of numpy, for one vehicle that flies, and tensors of PyTorch, for many that are simulated.
"""

import numpy as np

from uavrl_onboard.arrays import Array, library_of, like
from uavrl_onboard.perception.cells import grid_directions
from uavrl_onboard.perception.motion.sight import OBJECT

STEPS, PERIOD = 20, 0.1  # that are looked ahead, in s each: two seconds
TIMES = np.arange(1, STEPS + 1, dtype=np.float32) * np.float32(PERIOD)
LAG = 0.4  # s, until a commanded velocity is nearly flown
WIDE = 1.45  # m: 0.6 of wing, 0.35 of hull, 0.5 between
HIGH = 0.6  # m: 0.27 of fin, 0.14 of hull, 0.19 between
GREATEST = 2.2  # of threats
DIRECTIONS = grid_directions(24, (-0.5, 0.0, 0.5)).astype(np.float32)
"""In which a vehicle may fly, ``[72, 3]``: forward, left, up."""


def predict_path(commanded: Array, velocity: Array) -> Array:
    """Where a vehicle will be ``[*B, T, 3]`` from here: its velocity follows the commanded one with a first-order lag.

    Args:
        commanded: velocities ``[*B, 3]`` in m/s.
        velocity: what it has now, likewise.

    Examples:
        >>> predict_path(np.array([2.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0]))[-1].round(6).tolist()
        [4.0, 0.0, 0.0]
    """
    times = like(TIMES, commanded)
    lost = LAG * (1 - library_of(times).exp(-times / LAG))
    return commanded[..., None, :] * (times - lost)[:, None] + velocity[..., None, :] * lost[:, None]


def threat(gap: Array) -> Array:
    """How near one comes to a body and how soon ``[*B]``, of what lies between ``[*B, T, 3]``; 0 is far.

    Examples:
        >>> float(threat(np.full((STEPS, 3), 9.0)))
        0.0
    """
    library, times = library_of(gap), like(TIMES, gap)
    level = (gap[..., 0] ** 2 + gap[..., 1] ** 2) ** 0.5
    apart = library.maximum(level / WIDE, abs(gap[..., 2]) / HIGH)  # below 1: too near
    share = times / times[-1]
    soon = (1.2 - 0.2 * share - apart).clip(0.0) * (1 - 0.5 * share)
    return library.amax(soon, -1) + library.where((apart < 1).any(-1), library.ones_like(soon[..., 0]), 0.0)


def straight_on(objects: Array) -> tuple[Array, Array]:
    """The ways ``[N, K, T, 3]`` of moving objects ``[N, K * 7]``, and which of them there are, ``bool [N, K]``.

    The objects are those that :class:`uavrl.transforms.MotionSight` reports.
    """
    each = objects.reshape(*objects.shape[:-1], -1, len(OBJECT))
    ways = each[..., None, :3] + each[..., None, 3:6] * like(TIMES, each)[:, None]
    return ways, each[..., -1] > 0


def to_yaw(vectors: Array, yaw: Array) -> Array:
    """Turns vectors ``[N, ..., 3]`` from world axes into those of yaws ``[N]`` in rad.

    Examples:
        >>> to_yaw(np.array([[0.0, 2.0, 1.0]]), np.array([np.pi / 2])).round(3).tolist()
        [[2.0, 0.0, 1.0]]
    """
    library, yaw = library_of(vectors), yaw.reshape(-1, *[1] * (vectors.ndim - 2))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    cos, sin = library.cos(yaw), library.sin(yaw)
    return library.stack([cos * x + sin * y, cos * y - sin * x, z], -1)


def greatest_threats(commanded: Array, velocity: Array, ways: Array, known: Array) -> Array:
    """The greatest threat of any body on each commanded velocity, ``[N, *D]``.

    Args:
        commanded: ``[N, *D, 3]`` in m/s, in the axes of the vehicle's yaw, as all vectors here.
        velocity: of the vehicles in m/s, ``[N, 3]``.
        ways: where K bodies will be, seen from the vehicles, ``[N, K, T, 3]`` in m.
        known: which of them there are, ``bool [N, K]``.
    """
    library = library_of(commanded)
    worst = library.zeros_like(commanded[..., 0])
    spread = [1] * (commanded.ndim - 2)
    for body in range(known.shape[-1]):
        which = library.where(known[:, body])[0]
        if len(which):
            path = predict_path(commanded[which], velocity[which].reshape(-1, *spread, 3))
            gap = path - ways[which, body].reshape(-1, *spread, *ways.shape[2:])
            worst[which] = library.maximum(worst[which], threat(gap))
    return worst
