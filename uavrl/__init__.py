"""uavrl: LiDAR-only quadrotor navigation with TorchRL, after Chansuparp (2022)."""

from uavrl.envs.register import register_envs

__version__ = "0.1.0"

register_envs()
