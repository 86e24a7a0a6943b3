"""What is printed while a vehicle flies."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time

import pytest

from uavrl_onboard.cli.nonblocking_output import nonblocking_output


def test_all_comes_in_its_order(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    log = logging.StreamHandler(sys.stderr)
    monkeypatch.setattr(logging.root, "handlers", [log])
    monkeypatch.setattr("uavrl_onboard.cli.nonblocking_output._LONGEST_END", 30.0)
    with nonblocking_output():
        for number in range(100):
            sys.stdout.write(f"{number}\n")
        logging.getLogger("tests.telling").warning("the log's line")
    assert log.stream is sys.stderr
    out, err = capsys.readouterr()
    assert out.split() == [str(number) for number in range(100)] and err == "the log's line\n"


def test_a_terminal_that_hangs_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as hanging:
        monkeypatch.setattr(sys, "stdout", hanging)
        monkeypatch.setattr("uavrl_onboard.cli.nonblocking_output._LONGEST_END", 0.05)
        begun, longest = time.monotonic(), 0.0
        with nonblocking_output():
            for _ in range(5000):
                before = time.monotonic()
                sys.stdout.write("more than a pipe of 65,536 bytes can hold\n" * 10)
                longest = max(longest, time.monotonic() - before)
        assert longest < 5.0 and time.monotonic() - begun < 30.0, "nothing waits for the pipe"
        assert os.read(reader, 8) == b"more tha", "what had room has come"
        os.close(reader)
        for thread in threading.enumerate():
            if thread.name == "nonblocking output":  # else it would complain of the closed pipe during another test
                thread.join(30.0)
