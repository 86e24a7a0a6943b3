"""Networks as plain ``torch.nn`` modules."""

from typing import TYPE_CHECKING, Any

from uavrl.models.actor_critic import Actor, Critic, GaussianActor, mlp
from uavrl.models.batch_renorm import BatchRenorm, BatchRenormCritic
from uavrl.models.categorical import CategoricalCritic, UnitNormLinear
from uavrl.models.collision import (
    CollisionClassifier,
    ConfusionRates,
    LinearClassifier,
    MinMaxScaler,
    MLPClassifier,
    confusion_rates,
)
from uavrl.models.dynamics import RewardNet, SystemNet
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import PSAE, TrajectoryClassifier

if TYPE_CHECKING:
    from uavrl.models.memory import GRUMemory, RecurrentPolicy

__all__ = [
    "PSAE",
    "Actor",
    "BatchRenorm",
    "BatchRenormCritic",
    "CategoricalCritic",
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
    "UnitNormLinear",
    "confusion_rates",
    "mlp",
]


def __getattr__(name: str) -> Any:
    """Load TorchRL only for networks with a memory."""
    if name in ("GRUMemory", "RecurrentPolicy"):
        from uavrl.models import memory

        return getattr(memory, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
