"""Environments: the valley, its quadrotors, their LiDAR and the navigation task."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavrl.envs.lidar import Lidar, LidarConfig
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.envs.quadrotor import Aerodynamics, Airframe
    from uavrl.envs.randomization import Randomization
    from uavrl.envs.sensors import LidarSensor
    from uavrl.envs.vehicle_params import VehicleParams
    from uavrl.envs.world import World, WorldConfig

_MODULES = {
    "Aerodynamics": "quadrotor",
    "Airframe": "quadrotor",
    "Lidar": "lidar",
    "LidarConfig": "lidar",
    "LidarSensor": "sensors",
    "NavigationEnv": "navigation",
    "Randomization": "randomization",
    "VehicleParams": "vehicle_params",
    "World": "world",
    "WorldConfig": "world",
}
__all__ = [
    "Aerodynamics",
    "Airframe",
    "Lidar",
    "LidarConfig",
    "LidarSensor",
    "NavigationEnv",
    "Randomization",
    "VehicleParams",
    "World",
    "WorldConfig",
]


def __getattr__(name: str) -> Any:
    """Imports on first use: reading a configuration needs neither torch nor PyBullet."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
