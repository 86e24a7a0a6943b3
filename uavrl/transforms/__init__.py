"""TorchRL transforms: the LiDAR reduction, sight of what moves, memory, observation and the thesis's rewards."""

from uavrl.transforms.icosahedron import TruncatedIcosahedron
from uavrl.transforms.mirror import Mirror, mirror_action, mirror_observation
from uavrl.transforms.motion import MotionSight, MovingObjects
from uavrl.transforms.observation import LastAction, NavigationObservation, navigation_observation
from uavrl.transforms.range_image import RangeGrid, RangeImage
from uavrl.transforms.reduction import PointCloudReduction
from uavrl.transforms.rewards import (
    NavigationReward,
    SumOfTerms,
    TraditionalReward,
    navigation_reward,
    navigation_terms,
    traditional_reward,
    traditional_terms,
)
from uavrl.transforms.state import REDUCTIONS, NavigationState
from uavrl.transforms.threats import Threats
from uavrl.transforms.waypoint import Waypoint

__all__ = [
    "REDUCTIONS",
    "LastAction",
    "Mirror",
    "MotionSight",
    "MovingObjects",
    "NavigationObservation",
    "NavigationReward",
    "NavigationState",
    "PointCloudReduction",
    "RangeGrid",
    "RangeImage",
    "SumOfTerms",
    "Threats",
    "TraditionalReward",
    "TruncatedIcosahedron",
    "Waypoint",
    "mirror_action",
    "mirror_observation",
    "navigation_observation",
    "navigation_reward",
    "navigation_terms",
    "traditional_reward",
    "traditional_terms",
]
