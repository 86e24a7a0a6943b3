"""One clear sentence for a value out of range."""

import difflib
from collections.abc import Iterable
from typing import Any

from uavrl.errors import UavrlError


def require(condition: bool, key: str, expected: str, value: Any) -> None:
    """Raises one clear sentence unless ``condition`` holds."""
    if not condition:
        raise UavrlError(
            f"{key} must be {expected}, got {value!r}: change it in the configuration or on the command line."
        )


def did_you_mean(given: str, known: Iterable[str], before: str = "", otherwise: str = "") -> str:
    """A question about the nearest known name, or what is said where none is near."""
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=0.6)
    text = f"did you mean {near[0]}?" if near else otherwise
    return before + text if text else "."
