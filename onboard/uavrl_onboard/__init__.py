"""uavrl-onboard: flies an exported policy on a vehicle's computer, by its LiDAR and its autopilot, without PyTorch."""

__version__ = "0.2.0.dev0"
