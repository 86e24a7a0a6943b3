"""TorchRL transforms: the LiDAR reduction, the policy's observation and the thesis's rewards."""

from uavrl.transforms.mirror import Mirror, mirror_action, mirror_observation
from uavrl.transforms.observation import NavigationObservation, navigation_observation
from uavrl.transforms.rewards import NavigationReward, TraditionalReward, navigation_reward, traditional_reward
from uavrl.transforms.state import navigation_state
from uavrl.transforms.truncated_icosahedron import TruncatedIcosahedron
from uavrl.transforms.walker import WalkerReward, walker_reward

__all__ = [
    "Mirror",
    "NavigationObservation",
    "NavigationReward",
    "TraditionalReward",
    "TruncatedIcosahedron",
    "WalkerReward",
    "mirror_action",
    "mirror_observation",
    "navigation_observation",
    "navigation_reward",
    "navigation_state",
    "traditional_reward",
    "walker_reward",
]
