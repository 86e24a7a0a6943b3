"""What a vehicle has seen since its episode began, as a map, and the ways through it: NumPy and SciPy alone."""

from uavrl.mapping.episode_map import EpisodeMap
from uavrl.mapping.goal_finder import GoalFinder
from uavrl.mapping.navigator import Navigator
from uavrl.mapping.wayfinder import Wayfinder

__all__ = ["EpisodeMap", "GoalFinder", "Navigator", "Wayfinder"]
