"""A simulated vehicle behind LiDAR packets and MAVLink."""
