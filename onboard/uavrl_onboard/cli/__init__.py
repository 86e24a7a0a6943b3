"""The commands uavrl-fly and uavrl-scan."""
