"""What happens to data on its way into a replay buffer, and how it lies there.

It needs torch, tensordict, torchrl and sortedcontainers.
"""

from uavrl.buffers.admission import FailureBias, is_admitted
from uavrl.buffers.backward_reward import BackwardReward, StateClassifier
from uavrl.buffers.functional import backward_reward
from uavrl.buffers.history import TrajectoryHistory
from uavrl.buffers.multi_step import MultiStep, multi_step_returns
from uavrl.buffers.storage import FrameStorage, GatheringStorage

__all__ = [
    "BackwardReward",
    "FailureBias",
    "FrameStorage",
    "GatheringStorage",
    "MultiStep",
    "StateClassifier",
    "TrajectoryHistory",
    "backward_reward",
    "is_admitted",
    "multi_step_returns",
]
