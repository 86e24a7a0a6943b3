"""What all tests share."""

from __future__ import annotations

import faulthandler
import logging
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key

from tests.helpers.commands import TINY, in_process
from tests.helpers.measured import measured, wait_for_a_core

if TYPE_CHECKING:
    from uavrl.envs.place import Place
    from uavrl.envs.rules import WorldRules

_VALLEYS: dict[str, Place] = {}
os.environ.setdefault("BATCHED_PIPE_TIMEOUT", "300")  # s that TorchRL waits for an environment in another process


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Pytest ends its watch over a test at the first failure: what comes after it, and further tries, can hang, too."""
    seconds = float(node.config.getini("faulthandler_timeout") or 0.0)
    if seconds and isinstance(node, pytest.Item) and not node.config.getoption("usepdb"):
        faulthandler.dump_traceback_later(seconds, exit=True, file=node.config.stash[fault_handler_stderr_fd_key])


@pytest.fixture(scope="session", autouse=True)
def interrupts_are_heard() -> None:
    """A shell's background jobs do not hear Ctrl-C: the tests that send it do."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def cache_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests, and the commands that they start, leave the user's cache alone; those that run side by side share one."""
    root = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UAVRL_CACHE", str((root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / "cache"))
        yield


@pytest.fixture(autouse=True)
def further_tries_wait_for_a_core(request: pytest.FixtureRequest) -> None:
    """A test that the machine failed because it was busy would fail again while it is."""
    tries = getattr(request.node, "execution_count", 1)  # of pytest-rerunfailures
    if tries > 1 and request.node.get_closest_marker("flaky") == measured.mark:
        wait_for_a_core()


@pytest.fixture(autouse=True)
def log_is_heard() -> None:
    """Hydra silences what logged before it, and a test may have called it in this process."""
    logging.getLogger().setLevel(logging.WARNING)  # a sweep leaves ERROR behind
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("uavrl")]:
        logging.getLogger(name).disabled = False


@pytest.fixture(autouse=True)
def no_command_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that a test called in this process may have begun a long time ago."""
    try:
        from uavrl.runs import clock
    except ImportError:  # the tests of uavrl-onboard need no uavrl
        return
    monkeypatch.setattr(clock, "_began", [])


@pytest.fixture(scope="module", autouse=True)
def valleys_built_once() -> Iterator[None]:
    """Many tests fly in the same few valleys; tests/envs/test_world.py, which tests their building, builds anew."""
    try:
        from tests.helpers.finished import built_valley
        from uavrl.envs import world
    except ImportError:  # the tests of uavrl-onboard need no uavrl
        yield
        return
    build = world.build_place

    def build_once(config: WorldRules, number: int, origin: np.ndarray) -> Place:
        if not isinstance(config, world.WorldConfig):  # a file may have changed
            return build(config, number, origin)
        like, count = asdict(config), config.obstacles_of(number)
        # What a valley is like, its neighbours do not say, nor how many planes fly through it.
        key = repr(({**like, "seeds": None, "obstacles": count, "planes": config.planes > 0}, config.seeds[number]))
        if key not in _VALLEYS:
            _VALLEYS[key] = built_valley(key, lambda: build(config, number, origin))
        return replace(_VALLEYS[key], origin=origin)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world, "build_place", build_once)
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished training; tests look at it, or change a copy."""
    from tests.helpers.finished import finished_run

    return finished_run(tmp_path_factory.mktemp("runs") / "run", *TINY)


@pytest.fixture
def run_dir(finished: Path, tmp_path: Path) -> Path:
    """A copy of a finished run."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command in this process and returns the one sentence that it ends with."""

    def run(main: Callable[[], None], *arguments: str) -> str:
        capfd.readouterr()
        code = in_process(main, *arguments)
        out, err = capfd.readouterr()
        assert code == 1, (out, err)
        assert "Traceback" not in out + err
        (sentence,) = [line for line in err.splitlines() if line.startswith("uavrl: ")]
        return sentence

    return run
