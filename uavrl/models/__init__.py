"""Networks as plain ``torch.nn`` modules."""

from uavrl.models.actor_critic import Actor, Critic, GaussianActor, mlp
from uavrl.models.collision import (
    CollisionClassifier,
    ConfusionRates,
    LinearClassifier,
    MinMaxScaler,
    MLPClassifier,
    confusion_rates,
)
from uavrl.models.dynamics import RewardNet, SystemNet
from uavrl.models.memory import GRUMemory, RecurrentPolicy
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import PSAE, TrajectoryClassifier

__all__ = [
    "PSAE",
    "Actor",
    "CollisionClassifier",
    "ConfusionRates",
    "Critic",
    "GRUMemory",
    "GaussianActor",
    "LinearClassifier",
    "MLPClassifier",
    "MinMaxScaler",
    "OneShotClassifier",
    "RecurrentPolicy",
    "RewardNet",
    "SystemNet",
    "TrajectoryClassifier",
    "confusion_rates",
    "mlp",
]
