"""What a long piece of work shows: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import fcntl
import io
import logging
import os
import pty
import struct
import termios

import pytest

from uavrl.runs import progress_line
from uavrl.runs.clock import start_clock
from uavrl.runs.progress_line import ProgressLine

log = logging.getLogger(__name__)


class Terminal(io.StringIO):
    """Keeps what a terminal would show."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(progress_line.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(("columns", "drawn"), [(0, False), (80, True)])
def test_a_terminal_without_columns_gets_plain_lines(columns: int, drawn: bool) -> None:
    """As in some containers, where a bar would be as wide as the terminal: nothing."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    with os.fdopen(theirs, "w") as stream:
        assert progress_line._has_columns(stream) is drawn
    os.close(ours)


def test_a_file_gets_plain_lines_every_ten_seconds(capsys: pytest.CaptureFixture[str], clock: list[float]) -> None:
    with ProgressLine(100, "episodes") as line:
        for _ in range(100):
            clock[0] += 0.25
            line.add()
    assert capsys.readouterr().err.splitlines() == [
        "40/100 episodes | 00:10 elapsed, 00:15 left",
        "80/100 episodes | 00:20 elapsed, 00:05 left",
        "100/100 episodes | 00:25 elapsed",
    ]


def test_work_that_stops_says_how_far_it_was(capsys: pytest.CaptureFixture[str], clock: list[float]) -> None:
    with pytest.raises(KeyboardInterrupt), ProgressLine(1000, "steps", done=200) as line:
        clock[0] = 3.0
        line.set(300, "loss 0.5")
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "300/1,000 steps | 00:03 elapsed, loss 0.5\n"


@pytest.mark.parametrize("options", [{"enabled": False}, {"done": 10}])
def test_nothing_is_written_where_nothing_was_asked_for_or_done(
    options: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    with ProgressLine(10, "episodes", **options) as line:
        line.set(10)
    assert capsys.readouterr() == ("", "")


def test_without_a_standard_error_it_counts_and_writes_nothing(
    clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Python has none that is begun with ``2>&-``."""
    monkeypatch.setattr("sys.stderr", None)
    with ProgressLine(10, "episodes") as line:
        clock[0] = 20.0
        line.add()
    assert line.n == 1


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_a_message_has_a_line_of_its_own(
    stream: type[io.StringIO], monkeypatch: pytest.MonkeyPatch, clock: list[float]
) -> None:
    written = stream()
    monkeypatch.setattr(progress_line.sys, "stderr", written)
    monkeypatch.setattr(log, "disabled", False)  # as Hydra leaves it after a command in this process
    handler = logging.StreamHandler(written)
    logging.root.addHandler(handler)
    try:
        with ProgressLine(3, "episodes") as line:
            clock[0] = 20.0
            line.add()
            log.warning("Something is odd.")
            line.add()
    finally:
        logging.root.removeHandler(handler)
    shown = written.getvalue()
    lines = [each.rsplit("\r", 1)[-1] for each in shown.split("\n")]
    assert "Something is odd." in lines, shown
    assert ("\r" in shown) == written.isatty()


def test_a_terminal_has_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    written = Terminal()
    monkeypatch.setattr(progress_line.sys, "stderr", written)
    with ProgressLine(2, "episodes") as line:
        line.add(2)
    drawn = written.getvalue().split("\r")
    assert drawn[-1].startswith("2/2 episodes |") and drawn[-1].endswith("| 00:00 elapsed\n"), drawn


def test_of_a_command_the_time_since_its_beginning_is_shown(
    capsys: pytest.CaptureFixture[str], clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavrl.runs.clock._began", [])
    start_clock()
    clock[0] = 90.0
    with ProgressLine(48, "valleys", verb="building") as line:
        clock[0] = 102.0
        line.add(3)
    assert capsys.readouterr().err.splitlines() == [
        "building valleys 0/48 | 01:30 elapsed",
        "building valleys 3/48 | 01:42 elapsed, 03:00 left",
    ]
