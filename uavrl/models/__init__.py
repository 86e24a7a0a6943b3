"""Networks as plain ``torch.nn`` modules."""

from uavrl.models.actor_critic import Actor, Critic, GaussianActor, mlp
from uavrl.models.classifiers import LinearClassifier, MinMaxScaler, MLPClassifier
from uavrl.models.dynamics import RewardNet, SystemNet

__all__ = [
    "Actor",
    "Critic",
    "GaussianActor",
    "LinearClassifier",
    "MLPClassifier",
    "MinMaxScaler",
    "RewardNet",
    "SystemNet",
    "mlp",
]
