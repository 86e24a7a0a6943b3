"""One clear sentence for a value out of range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from uavrl.errors import UavrlError


def require(condition: bool, key: str, expected: str, value: Any) -> None:
    """Raises one clear sentence unless ``condition`` holds."""
    if not condition:
        raise UavrlError(
            f"{key} must be {expected}, got {value!r}: change it in the configuration or on the command line."
        )


def require_one_of(value: str, key: str, choices: Sequence[str]) -> None:
    """Raises one clear sentence unless ``value`` is one of ``choices``."""
    require(value in choices, key, f"one of {', '.join(choices)}", value)


def require_products(value: str, key: str = "products") -> None:
    """Raises one clear sentence unless ``value`` names what multiplies matrices."""
    require_one_of(value, key, ("mkl", "onednn", "bf16", "auto"))


def require_widths(widths: Sequence[int], key: str) -> None:
    """Raises one clear sentence unless ``widths`` are those of hidden layers."""
    require(len(widths) > 0 and min(widths) >= 1, key, "one or more widths above 0", list(widths))
