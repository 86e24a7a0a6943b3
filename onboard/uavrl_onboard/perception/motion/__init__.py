"""What moves around a LiDAR, by successive scans, and where it would be met: numpy alone."""

from uavrl_onboard.perception.motion.occlusion import Grid
from uavrl_onboard.perception.motion.sight import OBJECT, MotionSight

__all__ = ["OBJECT", "Grid", "MotionSight"]
