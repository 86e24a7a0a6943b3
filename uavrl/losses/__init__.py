"""Loss modules. They need torch, tensordict and torchrl only."""

from uavrl.losses.action_rate import ActionRate
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.actor_penalty import ActorPenalty, AuxiliaryModel
from uavrl.losses.crossq import CrossQLoss, CrossQTD3Loss
from uavrl.losses.ddpg import DDPGLoss
from uavrl.losses.fork import Fork
from uavrl.losses.imitation import Imitation
from uavrl.losses.lifeguard import LifeGuard
from uavrl.losses.psae import PSAELoss
from uavrl.losses.sac import SACLoss
from uavrl.losses.sequences import SequenceLoss
from uavrl.losses.td3 import TD3Loss
from uavrl.losses.xqc import XQCLoss, XQCTD3Loss

__all__ = [
    "ActionRate",
    "ActorCriticLoss",
    "ActorPenalty",
    "AuxiliaryModel",
    "CrossQLoss",
    "CrossQTD3Loss",
    "DDPGLoss",
    "Fork",
    "Imitation",
    "LifeGuard",
    "PSAELoss",
    "SACLoss",
    "SequenceLoss",
    "TD3Loss",
    "XQCLoss",
    "XQCTD3Loss",
]
