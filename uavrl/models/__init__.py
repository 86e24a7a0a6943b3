"""Networks as plain ``torch.nn`` modules."""

from uavrl.models.actor_critic import Actor, Critic, GaussianActor, mlp
from uavrl.models.classifiers import LinearClassifier, MinMaxScaler, MLPClassifier
from uavrl.models.collision_classifier import (
    CollisionClassifier,
    ConfusionRates,
    confusion_counts,
    confusion_rates,
)
from uavrl.models.dynamics import RewardNet, SystemNet
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import PSAE
from uavrl.models.trajectory_classifier import TrajectoryClassifier

__all__ = [
    "PSAE",
    "Actor",
    "CollisionClassifier",
    "ConfusionRates",
    "Critic",
    "GaussianActor",
    "LinearClassifier",
    "MLPClassifier",
    "MinMaxScaler",
    "OneShotClassifier",
    "RewardNet",
    "SystemNet",
    "TrajectoryClassifier",
    "confusion_counts",
    "confusion_rates",
    "mlp",
]
