"""What happens to data on its way into a replay buffer, and how it lies there.

It needs torch, tensordict, torchrl and sortedcontainers.
"""

from uavrl.buffers.abr import ABR, ABRPlus
from uavrl.buffers.backward_reward import BackwardReward, StateClassifier
from uavrl.buffers.functional import backward_reward, multi_step_returns
from uavrl.buffers.history import TrajectoryHistory
from uavrl.buffers.multi_step import MultiStep
from uavrl.buffers.replay import EpisodeBuffer, EpisodeFilter, PrioritizedBuffer
from uavrl.buffers.sequences import Windows
from uavrl.buffers.storage import FrameStorage, GatheringStorage

__all__ = [
    "ABR",
    "ABRPlus",
    "BackwardReward",
    "EpisodeBuffer",
    "EpisodeFilter",
    "FrameStorage",
    "GatheringStorage",
    "MultiStep",
    "PrioritizedBuffer",
    "StateClassifier",
    "TrajectoryHistory",
    "Windows",
    "backward_reward",
    "multi_step_returns",
]
