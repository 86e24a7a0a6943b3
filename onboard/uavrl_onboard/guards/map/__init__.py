"""What a vehicle has seen since its episode began, as a map, and the ways through it: NumPy and SciPy alone."""

from uavrl_onboard.guards.map.episode_map import EpisodeMap
from uavrl_onboard.guards.map.goal_finder import GoalFinder
from uavrl_onboard.guards.map.navigator import Navigator
from uavrl_onboard.guards.map.wayfinder import Wayfinder

__all__ = ["EpisodeMap", "GoalFinder", "Navigator", "Wayfinder"]
