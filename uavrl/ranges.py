"""The ranges of numbers that constructors take, as types: ``gamma: Discount = 0.99``.

A type checker sees the number; a configuration is checked against the range.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any


@dataclass(frozen=True)
class Range:
    """Which values are meant, in words and as a function.

    Args:
        words: what a value must be: "above 0".
        holds: whether a value of the right type is that.

    Examples:
        >>> Even = Annotated[int, Range("an even number", lambda value: value % 2 == 0)]
        >>> Even.__metadata__[0].holds(3)
        False
    """

    words: str
    holds: Callable[[Any], bool]


HOME = "a path, in which ~ is the home folder"  # stands beside a text in its type

Positive = Annotated[float, Range("above 0", lambda value: value > 0)]
NonNegative = Annotated[float, Range("at least 0", lambda value: value >= 0)]
Fraction = Annotated[float, Range("in [0, 1]", lambda value: 0 <= value <= 1)]
Discount = Annotated[float, Range("in [0, 1)", lambda value: 0 <= value < 1)]
Share = Annotated[float, Range("in (0, 1]", lambda value: 0 < value <= 1)]
Count = Annotated[int, Range("at least 1", lambda value: value >= 1)]
Whole = Annotated[int, Range("at least 0", lambda value: value >= 0)]
Pairs = Annotated[int, Range("an even number from 2", lambda value: value >= 2 and value % 2 == 0)]
Seed = Annotated[int, Range("in [0, 2**31)", lambda value: 0 <= value < 2**31)]
Folder = Annotated[str, HOME]
Widths = Annotated[Sequence[int], Range("one or more widths above 0", lambda value: len(value) > 0 and min(value) >= 1)]
