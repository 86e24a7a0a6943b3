"""A message for the user of a run that says nothing for a while."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

log = logging.getLogger(__name__)


class StallNotice:
    """Logs what is waited for, once in every silence that lasts; a text that changes is asked for when it is logged."""

    def __init__(self, text: str | Callable[[], str], seconds: float = 30.0) -> None:
        self.text, self.seconds = text, seconds
        self._last: float | None = time.monotonic()
        self._over = threading.Event()

    def reset(self) -> None:
        """Starts the clock again."""
        self._last = time.monotonic()

    def __enter__(self) -> StallNotice:
        """Begins to wait, in a thread of its own."""
        self.reset()
        self._over.clear()
        threading.Thread(target=self._wait, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Waits no more."""
        self._over.set()

    def _wait(self) -> None:
        while not self._over.wait(self.seconds / 10):
            if self._last is not None and time.monotonic() - self._last >= self.seconds:
                self._last = None
                log.info(self.text if isinstance(self.text, str) else self.text())
