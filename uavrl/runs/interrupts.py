"""Ctrl-C, SIGTERM and a terminal that closes while a run trains."""

import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}  # a run, unless they are ignored
PATIENCE = 10.0  # s for which a stopped run goes on at most, where its next checkpoint comes in half of them


class Stop:
    """Whether a run was asked to stop, and how long it may go on for.

    The first signal ends a run at once, or behind its next checkpoint where that comes soon; the second at once. While
    the run is ending, one signal more is let pass, and the next one breaks the ending off, which may hang.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._waiting = self._ending = self._insisted = False
        self._began, self._seconds_left = 0.0, float("inf")

    def handle(self, number: int, _: FrameType | None = None) -> None:
        """Handles a signal, and the alarm that ends the patience with the first one."""
        if self._ending and not self._insisted:
            self._insisted = True
            return
        self._waiting = not self._ending and self.signal is None and self._seconds_left <= PATIENCE / 2
        self.signal = self.signal or number
        if not self._waiting:
            raise KeyboardInterrupt
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)

    def begin(self) -> None:
        """From here on steps count towards the next checkpoint."""
        self._began = time.monotonic()

    def set_time_to_checkpoint(self, left: int, done: int) -> None:
        """Tells how soon the next checkpoint comes: ``left`` steps from now, after the ``done`` since the last one."""
        if self.signal is not None and not self._waiting:
            raise KeyboardInterrupt  # once more: what Python calls in passing may swallow the first
        self._seconds_left = max(left, 0) * (time.monotonic() - self._began) / max(done, 1)

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Around the writing of a checkpoint, which is finished first; then a run ends that was asked to."""
        self._seconds_left = 0.0
        yield
        self._seconds_left = float("inf")
        if self.signal is not None:
            raise KeyboardInterrupt

    def shutting_down(self) -> None:
        """From here on the run ends by itself."""
        self._ending = True
        if self._waiting:
            signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Blocks these signals meanwhile: processes that are started inherit this, and this one handles them later."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def interrupts_end(processes: Callable[[], None]) -> Iterator[None]:
    """As :func:`interrupts_held_back`, but one of these signals calls ``processes``, again and again until all is over.

    It ends the processes for which the main thread waits in a library, which then raises; the signal is handled next.
    """
    if threading.current_thread() is not threading.main_thread():
        with interrupts_held_back():
            yield
        return
    over, came, (told, teller) = threading.Event(), list[int](), socket.socketpair()
    teller.setblocking(False)
    handlers = {number: signal.getsignal(number) for number in ENDS}
    handlers = {number: each for number, each in handlers.items() if each not in (signal.SIG_IGN, None)}

    def watch() -> None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDS)  # this thread hears them, wherever the main one is
        while not ENDS & set(told.recv(64)) and not over.is_set():
            pass
        while not over.wait(0.2):
            processes()

    watcher = threading.Thread(target=watch, daemon=True, name="interrupts")
    with interrupts_held_back(), told, teller:
        try:
            for number in handlers:  # none may raise in the midst of what follows: a signal is noted
                signal.signal(number, lambda number, _: came.append(number))
            before = signal.set_wakeup_fd(teller.fileno(), warn_on_full_buffer=False)
            watcher.start()
            try:
                yield
            finally:
                over.set()
                teller.send(b"\0")
                watcher.join()
                signal.set_wakeup_fd(before)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            for first in came[:1]:
                signal.raise_signal(first)  # comes when it is no longer held back


@contextmanager
def stoppable() -> Iterator[Stop]:
    """Handles Ctrl-C, SIGTERM and a terminal that closes in the main thread, unless they are ignored.

    A shell ignores Ctrl-C for its background jobs, ``nohup`` ignores the terminal's end.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGALRM, *ENDS)}
    before = {number: each for number, each in before.items() if each not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, stop.handle)
    try:
        yield stop
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
