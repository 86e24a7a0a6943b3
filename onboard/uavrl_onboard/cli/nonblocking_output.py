"""What a command tells while a vehicle flies: a terminal that hangs, or a pipe that nobody reads, holds nothing up."""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from queue import Full, Queue
from threading import Thread
from typing import TextIO, cast

_logger = logging.getLogger(__name__)

WAITING = 1000  # pieces of text that may wait for a terminal; what comes then is not told
_LONGEST_END = 1.0  # s that the end waits for it


class _NonblockingStream(io.TextIOBase):
    """Takes text in no time; a thread writes it to a stream."""

    def __init__(self, stream: TextIO) -> None:
        stream.flush()
        self._stream, self._ended = stream, False
        self._queue: Queue[str | None] = Queue(WAITING)
        self._thread = Thread(target=self._work, name="nonblocking output", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        with suppress(Full):  # the terminal hangs, or nobody reads
            self._queue.put_nowait(text)
        return len(text)

    def end(self) -> None:
        """Lets what waits be written, if it can be soon."""
        self._ended = True
        self.write("")
        self._thread.join(_LONGEST_END)

    def _work(self) -> None:
        try:
            while not (self._ended and self._queue.empty()):
                self._put(self._queue.get() or "")
        except OSError as error:
            _logger.warning("Nobody reads what is printed (%s): the flight goes on.", error.strerror)

    def _put(self, text: str) -> None:
        """Writes past the stream's own lock, which a thread that hangs would keep until the process ends."""
        try:
            number = self._stream.fileno()
        except (OSError, ValueError):  # a stream within this process
            self._stream.write(text)
            return
        data = text.encode(self._stream.encoding, self._stream.errors or "strict")
        while data:
            data = data[os.write(number, data) :]


@contextmanager
def nonblocking_output() -> Iterator[None]:
    """Lets threads write what is printed and logged within the block."""
    out, err = _NonblockingStream(sys.stdout), _NonblockingStream(sys.stderr)
    logs = [each for each in logging.root.handlers if getattr(each, "stream", None) is sys.stderr]
    handlers = [cast("logging.StreamHandler[TextIO]", each) for each in logs]
    before = [handler.setStream(cast(TextIO, err)) for handler in handlers]
    try:
        with redirect_stdout(cast(TextIO, out)), redirect_stderr(cast(TextIO, err)):
            yield
    finally:
        for handler, stream in zip(handlers, before, strict=True):
            if stream is not None:
                handler.setStream(stream)
        out.end()
        err.end()
