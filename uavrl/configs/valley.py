"""Typed configuration of the valley: its task, perception and rewards. Meanings and units stand in the yaml."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from uavrl.configs.checks import require, require_one_of
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.limits import check_hull
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.world import WorldConfig


@dataclass
class EnvConfig:
    """conf/env: the task."""

    name: str = "static"
    num_uavs: int = 8
    max_steps: int = 300
    goal_angle: str = "elevation"
    world: WorldConfig = field(default_factory=WorldConfig)
    airframe: Airframe = field(default_factory=Airframe)
    aerodynamics: Aerodynamics = field(default_factory=Aerodynamics)

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.num_uavs >= 1, "env.num_uavs", "at least 1", self.num_uavs)
        require(self.max_steps >= 1, "env.max_steps", "at least 1", self.max_steps)
        require_one_of(self.goal_angle, "env.goal_angle", ("elevation", "course"))
        for key in ("collision_radius", "collision_height", "lidar_diameter", "lidar_height", "torque_to_thrust"):
            require(getattr(self.airframe, key) > 0, f"env.airframe.{key}", "above 0", getattr(self.airframe, key))
        tilt = self.airframe.tilt_limit
        require(0 < tilt < math.pi / 2, "env.airframe.tilt_limit", "an angle in (0, π/2) rad", tilt)
        check_hull(self.airframe, self.world)


@dataclass
class PerceptionConfig:
    """conf/perception: LiDAR, reduction, scaling and frames."""

    name: str = "truncated_icosahedron"
    radius: float = 4.0
    statistic: str = "face"
    angles: str = "folded"
    frames: int = 3
    blind: bool = False
    blind_to: str | None = None
    lidar: LidarConfig = field(default_factory=lambda: LidarConfig(max_range=4.0))

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(self.radius > 0, "perception.radius", "a length above 0 m", self.radius)
        require(self.frames >= 1, "perception.frames", "at least 1", self.frames)
        require_one_of(self.statistic, "perception.statistic", ("face", "range"))
        require_one_of(self.angles, "perception.angles", ("folded", "raw"))
        require(self.blind_to in (None, "planes"), "perception.blind_to", "null or planes", self.blind_to)


@dataclass
class TraditionalRewardConfig:
    """conf/reward/traditional.yaml."""

    name: str = "traditional"
    arrived_reward: float = 50.0
    collided_reward: float = -50.0


@dataclass
class NavigationRewardConfig:
    """conf/reward/navigation.yaml and navigation_prize.yaml."""

    name: str = "navigation"
    weights: tuple[float, ...] = (8.0, 1.0, 0.5, 0.5)
    flight_level: float = 3.5
    collided_reward: float = -50.0
    arrived_reward: float = 0.0
    altitude_term: str = "absolute"

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(len(self.weights) == 4, "reward.weights", "four numbers w_1 to w_4", list(self.weights))
        require(self.flight_level > 0, "reward.flight_level", "a height above 0 m", self.flight_level)
        require_one_of(self.altitude_term, "reward.altitude_term", ("absolute", "literal"))
