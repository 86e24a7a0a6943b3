"""uavrl: LiDAR-only quadrotor navigation with TorchRL, after Chansuparp (2022)."""

__version__ = "0.1.0"
