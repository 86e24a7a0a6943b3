"""A vehicle and its LiDAR by ROS 2, without a ROS installation."""
