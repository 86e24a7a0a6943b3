"""The ranges of numbers that constructors take, as types: ``gamma: Discount = 0.99``.

A type checker sees the number; a configuration is validated against the range, by pydantic. A range that is not here is
written in the constructor: ``num_uavs: Annotated[int, Field(ge=1, le=512)]``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


@dataclass(frozen=True)
class Rule:
    """Which values are meant where two bounds do not say it, in words and as a function.

    Args:
        words: what a value must be: "an even number".
        holds: whether a value of the right type is that.

    Examples:
        >>> Even = Annotated[int, Rule("an even number", lambda value: value % 2 == 0)]
        >>> Even.__metadata__[0].holds(3)
        False
    """

    words: str
    holds: Callable[[Any], bool]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Lets pydantic validate the type, and then the rule."""
        return core_schema.no_info_after_validator_function(self._validated, handler(source))

    def _validated(self, value: Any) -> Any:
        if not self.holds(value):
            raise PydanticCustomError("rule", "{words}", {"words": self.words})
        return value


def bounds(constraint: Any) -> dict[str, float]:
    """The bounds that a part of an annotation holds, by their names: ``ge``, ``gt``, ``le``, ``lt``."""
    parts = constraint.metadata if isinstance(constraint, FieldInfo) else [constraint]
    names = [(part, name) for part in parts for name in ("ge", "gt", "le", "lt")]
    return {name: getattr(part, name) for part, name in names if getattr(part, name, None) is not None}


def words(ge: float | None = None, gt: float | None = None, le: float | None = None, lt: float | None = None) -> str:
    """Bounds as a sentence has them.

    Examples:
        >>> words(gt=0), words(ge=0, lt=1), words(le=512)
        ('above 0', 'in [0, 1)', 'at most 512')
    """
    if (ge is None and gt is None) or (le is None and lt is None):
        told = {"at least": ge, "above": gt, "at most": le, "below": lt}
        return " and ".join(f"{name} {value:.10g}" for name, value in told.items() if value is not None)
    below = f"({gt:.10g}" if ge is None else f"[{ge:.10g}"
    return f"in {below}, " + (f"{lt:.10g})" if le is None else f"{le:.10g}]")


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _at_home(value: Any) -> Any:
    if not (isinstance(value, str) and value.startswith("~")):
        return value
    try:
        return str(Path(value).expanduser())
    except RuntimeError as error:  # there is no such user
        words = "a folder, where one that is called so is written ./{value}"
        raise PydanticCustomError("rule", words, {"value": value}) from error


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Discount = Annotated[float, Field(ge=0, lt=1)]
Share = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Whole = Annotated[int, Field(ge=0)]
Pairs = Annotated[int, Rule("an even number from 2", lambda value: value >= 2 and value % 2 == 0)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
Text = Annotated[str, BeforeValidator(_as_text)]
"""A text, which may look like a number: ``run_dir=2026``."""
Folder = Annotated[str, BeforeValidator(_at_home), BeforeValidator(_as_text)]
"""A path, in which ``~`` is the home folder."""
Widths = Annotated[Sequence[int], Rule("one or more widths above 0", lambda value: len(value) > 0 and min(value) >= 1)]
