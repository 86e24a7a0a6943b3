"""TorchRL transforms: guards, the LiDAR reduction, motion detection, observation and the thesis's rewards."""

from uavrl.transforms.guarded import Guarded
from uavrl.transforms.icosahedron import TruncatedIcosahedron
from uavrl.transforms.mirror import Mirror, mirror_action, mirror_observation
from uavrl.transforms.motion import MotionSight, MovingObjects
from uavrl.transforms.observation import LastAction, NavigationObservation, navigation_observation
from uavrl.transforms.privileged import Privileged
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

__all__ = [
    "REDUCTIONS",
    "Guarded",
    "LastAction",
    "Mirror",
    "MotionSight",
    "MovingObjects",
    "NavigationObservation",
    "NavigationReward",
    "NavigationState",
    "PointCloudReduction",
    "Privileged",
    "RangeGrid",
    "RangeImage",
    "SumOfTerms",
    "Threats",
    "TraditionalReward",
    "TruncatedIcosahedron",
    "mirror_action",
    "mirror_observation",
    "navigation_observation",
    "navigation_reward",
    "navigation_terms",
    "traditional_reward",
    "traditional_terms",
]
