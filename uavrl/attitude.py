"""Roll, pitch and yaw."""

import numpy as np


def body_to_world(attitudes: np.ndarray) -> np.ndarray:
    """Rotations ``[N, 3, 3]`` of roll, pitch and yaw ``[N, 3]`` in rad: yaw about z, then pitch, then roll.

    Examples:
        >>> (body_to_world(np.array([[0.0, 0.0, np.pi / 2]]))[0] @ [1.0, 0.0, 0.0]).round(9).tolist()
        [0.0, 1.0, 0.0]
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitudes).T, np.sin(attitudes).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def body_to_level(attitudes: np.ndarray) -> np.ndarray:
    """Rotations ``[N, 3, 3]`` of the same into axes that are level and point where the yaw does.

    Examples:
        >>> (body_to_level(np.array([[0.0, 0.0, 2.0]]))[0] @ [1.0, 0.0, 0.0]).tolist()
        [1.0, 0.0, 0.0]
    """
    return body_to_world(attitudes * [1.0, 1.0, 0.0])
