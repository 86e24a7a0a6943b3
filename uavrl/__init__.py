"""uavrl: LiDAR navigation of a quadrotor with TorchRL, after Chansuparp (2022)."""

import importlib
from typing import TYPE_CHECKING, Any

from uavrl.envs.register import register_with_gymnasium

if TYPE_CHECKING:
    from uavrl.buffers import ABR, ABRPlus, BackwardReward, EpisodeBuffer, MultiStep, PrioritizedBuffer
    from uavrl.envs import Airframe, LidarConfig, NavigationEnv, Randomization, WorldConfig
    from uavrl.errors import UavrlError
    from uavrl.evaluation.policies import load_policy
    from uavrl.export.recorded import load_data
    from uavrl.losses import ActionRate, DDPGLoss, Fork, Imitation, LifeGuard, SACLoss, TD3Loss
    from uavrl.models import Actor, Critic, GaussianActor
    from uavrl.transforms import (
        Guarded,
        Mirror,
        MovingObjects,
        NavigationReward,
        NavigationState,
        RangeGrid,
        RangeImage,
        Threats,
        TraditionalReward,
        TruncatedIcosahedron,
    )

__version__ = "0.2.0.dev0"
__all__ = [
    "ABR",
    "ABRPlus",
    "ActionRate",
    "Actor",
    "Airframe",
    "BackwardReward",
    "Critic",
    "DDPGLoss",
    "EpisodeBuffer",
    "Fork",
    "GaussianActor",
    "Guarded",
    "Imitation",
    "LidarConfig",
    "LifeGuard",
    "Mirror",
    "MovingObjects",
    "MultiStep",
    "NavigationEnv",
    "NavigationReward",
    "NavigationState",
    "PrioritizedBuffer",
    "Randomization",
    "RangeGrid",
    "RangeImage",
    "SACLoss",
    "TD3Loss",
    "Threats",
    "TraditionalReward",
    "TruncatedIcosahedron",
    "UavrlError",
    "WorldConfig",
    "load_data",
    "load_policy",
]

_ROOMS = {
    "buffers": ("ABR", "ABRPlus", "BackwardReward", "EpisodeBuffer", "MultiStep", "PrioritizedBuffer"),
    "envs": ("Airframe", "LidarConfig", "NavigationEnv", "Randomization", "WorldConfig"),
    "errors": ("UavrlError",),
    "evaluation.policies": ("load_policy",),
    "export.recorded": ("load_data",),
    "losses": ("ActionRate", "DDPGLoss", "Fork", "Imitation", "LifeGuard", "SACLoss", "TD3Loss"),
    "models": ("Actor", "Critic", "GaussianActor"),
    "transforms": (
        *("Guarded", "Mirror", "MovingObjects", "NavigationReward", "NavigationState", "RangeGrid", "RangeImage"),
        *("Threats", "TraditionalReward", "TruncatedIcosahedron"),
    ),
}
_MODULES = {name: room for room, names in _ROOMS.items() for name in names}

register_with_gymnasium()


def __getattr__(name: str) -> Any:
    """Import a name on its first use, so that ``import uavrl`` loads neither torch nor PyBullet."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f"uavrl.{_MODULES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """List the names that are imported on first use as well."""
    return sorted({*globals(), *__all__})
