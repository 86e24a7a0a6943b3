"""A stopwatch for nested functions: each second belongs to the innermost one that it watches."""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Stopwatch:
    """Adds up the time spent in watched functions, without that of watched functions within them.

    Args:
        rest: the part that what happens outside of all watched functions counts as.
    """

    def __init__(self, rest: str) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._parts, self._since = [rest], time.perf_counter()

    def _switch(self) -> None:
        now = time.perf_counter()
        self.seconds[self._parts[-1]] += now - self._since
        self._since = now

    def reset(self) -> None:
        """Starts at 0."""
        self.seconds.clear()
        self._since = time.perf_counter()

    def stop(self) -> dict[str, float]:
        """Returns the seconds of each part until now."""
        self._switch()
        return dict(self.seconds)

    def watched(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Returns the function, its time counted as ``part``."""

        @functools.wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            self._switch()
            self._parts.append(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._switch()
                self._parts.pop()

        return run

    @contextmanager
    def watching(self, places: dict[str, list[tuple[Any, str]]]) -> Iterator[None]:
        """Watches the functions at ``(owner, name)`` of each part, and puts them back at the end."""
        before = [(owner, name, getattr(owner, name)) for owned in places.values() for owner, name in owned]
        try:
            for part, owned in places.items():
                for owner, name in owned:
                    setattr(owner, name, self.watched(part, getattr(owner, name)))
            yield
        finally:
            for owner, name, function in before:
                setattr(owner, name, function)
