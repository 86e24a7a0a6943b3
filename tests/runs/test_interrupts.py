"""How signals are taken; tests/check sends them to trainings."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

import numpy as np
import pytest

from uavrl.runs.interrupts import PATIENCE, Stop, interrupts_end, stoppable


def test_signals_are_given_back_to_who_had_them() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with stoppable() as stop:
            stop.shutting_down()
            os.kill(os.getpid(), signal.SIGTERM)
        assert stop.signal is None and not heard
        os.kill(os.getpid(), signal.SIGTERM)
        assert heard == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_checkpoint_that_is_being_written_is_finished(number: signal.Signals) -> None:
    done: list[str] = []
    before = signal.signal(number, lambda *_: done.append("passed"))
    try:
        with pytest.raises(KeyboardInterrupt), stoppable() as stop, stop.deferred():
            os.kill(os.getpid(), number)
            done.append("written")
    finally:
        signal.signal(number, before)
    assert done == ["written"] and stop.signal == number
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_an_interrupt_that_was_swallowed_comes_again() -> None:
    stop = Stop()
    stop.begin()
    with pytest.raises(KeyboardInterrupt):
        stop.handle(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        stop.set_time_to_checkpoint(1, 1)


def test_an_interrupt_at_any_moment_leaves_no_watcher_behind() -> None:
    ended, before = threading.Event(), [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    for moment in [*np.random.default_rng(0).uniform(0.0, 2e-3, 40), 0.3]:
        signaller = threading.Timer(moment, os.kill, (os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            signaller.start()
            with interrupts_end(ended.set):
                ended.wait(20.0 if moment == 0.3 else 0.0)
            signaller.join()
            signal.pthread_sigmask(signal.SIG_BLOCK, [])  # Python looks for what has come
        signaller.join()
        assert "interrupts" not in [thread.name for thread in threading.enumerate()]
        assert signal.set_wakeup_fd(-1) == -1
        assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert ended.is_set(), "what was waited for was ended"


@pytest.mark.parametrize(("left", "waits"), [(4, True), (6, False)])
def test_what_comes_soon_is_told_from_how_long_steps_take(
    left: int, waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("uavrl.runs.interrupts.time.monotonic", lambda: now[0])
    armed: list[float] = []
    monkeypatch.setattr("uavrl.runs.interrupts.signal.setitimer", lambda _, seconds: armed.append(seconds))
    stop = Stop()
    stop.begin()
    now[0] += 10.0
    stop.set_time_to_checkpoint(left, 10)  # a step takes a second; half of the patience are five
    heard: Callable[[], None] = lambda: stop.handle(signal.SIGINT)  # noqa: E731
    if waits:
        heard()
        assert armed == [PATIENCE]
        stop.set_time_to_checkpoint(1, 13)
    with pytest.raises(KeyboardInterrupt):
        heard()
