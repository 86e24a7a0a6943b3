"""When the command of this process began: its progress lines show the time since then."""

import time

_began: list[float] = []  # empty in a program that is no command


def start_clock(at: float | None = None) -> None:
    """Begin a command, at a time of ``time.monotonic()``; None: now."""
    _began[:] = [time.monotonic() if at is None else at]


def command_began(otherwise: float) -> float:
    """When the command began, by ``time.monotonic()``, or another time where there is no command."""
    return _began[0] if _began else otherwise
