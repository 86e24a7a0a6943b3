"""What moves around a LiDAR, by successive scans, and where it would be met: numpy alone."""

from uavrl.motion.occlusion import Grid
from uavrl.motion.sight import OBJECT, MotionSight

__all__ = ["OBJECT", "Grid", "MotionSight"]
