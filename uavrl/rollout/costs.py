"""What a direction costs the rule vfh; loads nothing heavy, so that a configuration is checked at once."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Costs:
    """What a direction costs a :class:`VectorFieldHistogram`, and how fast it is flown.

    Attributes:
        obstacle: of a direction whose cell is full.
        goal: of a direction that leads away from the goal.
        level: of a metre off the flight level after a second, in a direction.
        turn: of a direction behind the UAV.
        width: how near a cell must be to a direction to count: the power of the cosine between them.
        nearness: power of what a cell tells over the radius; the greater, the less far things count.
        caution: share of the speed that is left out where the way is full, in [0, 1].
    """

    obstacle: float
    goal: float
    level: float
    turn: float
    width: float
    nearness: float
    caution: float
