"""uavrl: LiDAR-only quadrotor navigation with TorchRL, after Chansuparp (2022)."""

import importlib
from typing import Any

from uavrl.envs.register import register_envs

__version__ = "0.2.0.dev0"
__all__ = ["load_policy"]

register_envs()


def __getattr__(name: str) -> Any:
    """Imports on first use: ``import uavrl`` loads nothing that takes time."""
    if name != "load_policy":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module("uavrl.evaluation.policies").load_policy
