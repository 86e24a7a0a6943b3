"""What a contract says of the map that leads a policy, read off the transform of its training."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from uavrl_onboard.guards.map import navigator

if TYPE_CHECKING:
    from uavrl.transforms import Waypoint

POSE = {
    "waypoint": "degrees in [0, 360), as heading: to the next point of the quickest way to the goal, see memory.found; "
    "it is the heading where the way leads straight on or none is left"
}
FOUND = (
    "by uavrl_onboard Navigator: of every memory.every-th scan what lies within memory.sight m of the sensor "
    "and at most memory.level m over or under the altitude's divisor enters a grid of cells of memory.cell m, which "
    "forgets beyond memory.reach m; in it the quickest way to the goal is searched, where what was not seen is "
    "free and the hull fits; the next point is the last one in a straight line, or else the one "
    "memory.ahead m along the way; what has found the way otherwise will do. An episode begins without a map"
)


def memory_terms(led: Waypoint) -> dict[str, Any]:
    """The part ``memory``, which :class:`uavrl_onboard.policy.contract.MemoryTerms` reads."""
    return {
        "sight": led.sight,
        "reach": led.reach,
        "cell": navigator.CELL,
        "level": navigator.LEVEL,
        "every": navigator.EVERY,
        "ahead": navigator.AHEAD,
        "found": FOUND,
    }
