"""How far a long piece of work is: a bar on a terminal, plain lines in a file or a pipe."""

import os
import sys
import threading
import time
from contextlib import ExitStack
from typing import TextIO

from uavrl.errors import extras
from uavrl.runs.clock import command_began

with extras():
    from tqdm import tqdm
    from tqdm.contrib.logging import logging_redirect_tqdm

EVERY = 10.0  # s between two lines where no bar is drawn


class _Bar(tqdm):
    """A bar with a lock of this process alone: tqdm's own would outlive a process that is killed, with a warning."""


_Bar.set_lock(threading.RLock())


class ProgressLine:
    """What is done, of how much, for how long; a context manager that closes the line.

    On a terminal one line is drawn again and again, and what is logged meanwhile stands above it. Elsewhere a line is
    written every 10 s, and a last one at the end: a log holds no control characters, and no message inside a line. The
    elapsed time is that of the command, where there is one.

    Args:
        total: of the units.
        unit: what is counted, in the plural.
        done: where it begins.
        verb: what is done with the units: "building" valleys 3/48.
        enabled: False shows nothing.

    Examples:
        >>> with ProgressLine(8, "episodes", enabled=False) as line:
        ...     line.add(2)
        >>> print(line)
        2/8 episodes | 00:00 elapsed, 00:00 left
    """

    def __init__(self, total: int, unit: str, *, done: int = 0, verb: str = "", enabled: bool = True) -> None:
        enabled = enabled and sys.stderr is not None  # None: it was closed before Python began
        terminal = enabled and _has_columns(sys.stderr)
        self.n, self._total, self._unit, self._verb, self._text = done, total, unit, verb, ""
        self._first = self._written = done
        self._writes = enabled and not terminal
        self._began = self._last = time.monotonic()
        self._clock = command_began(self._began)
        counted = f"{verb} {unit} {{n:,}}/{{total:,}}" if verb else f"{{n:,}}/{{total:,}} {unit}"
        self._redirected = ExitStack()
        self._bar = _Bar(
            total=total,
            initial=done,
            disable=not terminal,
            dynamic_ncols=True,
            mininterval=0.5,
            bar_format=f"{counted} |{{bar:12}}| {{elapsed}} elapsed{{postfix}}",
        )
        if terminal:
            self._redirected.enter_context(logging_redirect_tqdm())
            self._bar.start_t -= self._began - self._clock
            self._bar.refresh()
        elif verb and self._writes:  # what is built comes before all else: the first line tells that it goes on
            self._write()

    def set(self, done: int, text: str | None = None) -> None:
        """Shows that so many units are done.

        Args:
            done: units in all.
            text: what follows; the time left where it is None.
        """
        self.n = done
        self._text = self._left() if text is None else text
        self._bar.set_postfix_str(self._text, refresh=False)
        self._bar.update(done - self._bar.n)
        if self._writes and time.monotonic() - self._last >= EVERY:
            self._write()

    def add(self, more: int = 1, text: str | None = None) -> None:
        """Shows that ``more`` units are done."""
        self.set(self.n + more, text)

    def close(self) -> None:
        """Leaves the line as it is."""
        if self._writes and self.n != self._written:
            self._write()
        self._bar.close()
        self._redirected.close()

    def __enter__(self) -> "ProgressLine":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __str__(self) -> str:
        elapsed, numbers = tqdm.format_interval(time.monotonic() - self._clock), f"{self.n:,}/{self._total:,}"
        counted = f"{self._verb} {self._unit} {numbers}" if self._verb else f"{numbers} {self._unit}"
        return f"{counted} | {elapsed} elapsed" + (f", {self._text}" if self._text else "")

    def _left(self) -> str:
        if self.n == self._first or self.n >= self._total:
            return ""
        each = (time.monotonic() - self._began) / (self.n - self._first)
        return f"{tqdm.format_interval(each * (self._total - self.n))} left"

    def _write(self) -> None:
        self._last, self._written = time.monotonic(), self.n
        sys.stderr.write(f"{self}\n")
        sys.stderr.flush()


def _has_columns(stream: TextIO) -> bool:
    """Whether a bar can be drawn: on a terminal that does not say that it has no columns, as some containers do."""
    if not stream.isatty():
        return False
    try:
        return os.get_terminal_size(stream.fileno()).columns > 0
    except (OSError, ValueError):  # it has no width, or no number
        return True
