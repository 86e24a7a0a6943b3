"""What the user is told when a run says nothing for a while."""

from __future__ import annotations

import logging
import threading
import time
from types import TracebackType

SECONDS = 30.0

log = logging.getLogger(__name__)


class StallNotice:
    """Says what is waited for, once in every silence that lasts."""

    def __init__(self, text: str, seconds: float | None = None) -> None:
        self.text = text
        self.seconds = SECONDS if seconds is None else seconds
        self._last: float | None = time.monotonic()
        self._over = threading.Event()

    def reset(self) -> None:
        """Begins the next stall_notice."""
        self._last = time.monotonic()

    def __enter__(self) -> StallNotice:
        """Listens, in a thread of its own."""
        self.reset()
        self._over.clear()
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Listens no more."""
        self._over.set()

    def _listen(self) -> None:
        while not self._over.wait(self.seconds / 10):
            if self._last is not None and time.monotonic() - self._last >= self.seconds:
                self._last = None
                log.info(self.text)
