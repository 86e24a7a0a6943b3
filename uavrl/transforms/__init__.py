"""TorchRL transforms: the LiDAR reduction, the policy's observation and the thesis's rewards."""

from uavrl.transforms.last_action import LastAction
from uavrl.transforms.mirror import Mirror, mirror_action, mirror_observation
from uavrl.transforms.observation import NavigationObservation, navigation_observation
from uavrl.transforms.point_cloud_reduction import PointCloudReduction
from uavrl.transforms.range_image import RangeImage
from uavrl.transforms.reductions import REDUCTIONS
from uavrl.transforms.rewards import (
    NavigationReward,
    SumOfTerms,
    TraditionalReward,
    navigation_reward,
    navigation_terms,
    traditional_reward,
    traditional_terms,
)
from uavrl.transforms.state import NavigationState
from uavrl.transforms.truncated_icosahedron import TruncatedIcosahedron

__all__ = [
    "REDUCTIONS",
    "LastAction",
    "Mirror",
    "NavigationObservation",
    "NavigationReward",
    "NavigationState",
    "PointCloudReduction",
    "RangeImage",
    "SumOfTerms",
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
