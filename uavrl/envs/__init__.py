"""Environments: worlds, their quadrotors, their LiDAR and the navigation task."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavrl.envs.file_worlds import CloudConfig, MeshConfig
    from uavrl.envs.forest import ForestConfig
    from uavrl.envs.lidar import Lidar, LidarConfig
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.envs.quadrotor import Aerodynamics, Airframe
    from uavrl.envs.randomization import Randomization
    from uavrl.envs.rooms import RoomsConfig
    from uavrl.envs.rules import Scene, Solid, WorldRules
    from uavrl.envs.sensors import LidarSensor
    from uavrl.envs.vehicle_params import VehicleParams
    from uavrl.envs.world import World, WorldConfig

_MODULES = {
    "Aerodynamics": "quadrotor",
    "Airframe": "quadrotor",
    "CloudConfig": "file_worlds",
    "ForestConfig": "forest",
    "Lidar": "lidar",
    "LidarConfig": "lidar",
    "LidarSensor": "sensors",
    "MeshConfig": "file_worlds",
    "NavigationEnv": "navigation",
    "Randomization": "randomization",
    "RoomsConfig": "rooms",
    "Scene": "rules",
    "Solid": "rules",
    "VehicleParams": "vehicle_params",
    "World": "world",
    "WorldConfig": "world",
    "WorldRules": "rules",
}
__all__ = [
    "Aerodynamics",
    "Airframe",
    "CloudConfig",
    "ForestConfig",
    "Lidar",
    "LidarConfig",
    "LidarSensor",
    "MeshConfig",
    "NavigationEnv",
    "Randomization",
    "RoomsConfig",
    "Scene",
    "Solid",
    "VehicleParams",
    "World",
    "WorldConfig",
    "WorldRules",
]


def __getattr__(name: str) -> Any:
    """Imports on first use: reading a configuration needs neither torch nor PyBullet."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
