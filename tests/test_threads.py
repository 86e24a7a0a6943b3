"""What several threads of one program may do side by side, though it is one for the whole process."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from tensordict import TensorDict
from torchrl.envs.utils import exploration_type

import uavrl
from tests.helpers.folders import ROOT
from uavrl.config import compose
from uavrl.envs.bullet import connect, pybullet
from uavrl.evaluation.rollout import rollout
from uavrl.locks import OneAtATime
from uavrl_onboard.files import replacing, writable


@contextmanager
def eager_threads() -> Iterator[None]:
    """Threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def side_by_side(action: Callable[[int], Any], count: int) -> list[Any]:
    with eager_threads(), ThreadPoolExecutor(4) as threads:
        return list(threads.map(action, range(count)))


def test_the_output_of_a_process_stays_where_it_was() -> None:
    def where() -> list[tuple[int, int]]:
        return [(os.fstat(descriptor).st_dev, os.fstat(descriptor).st_ino) for descriptor in (1, 2)]

    before = where()
    for client in side_by_side(lambda _: connect(), 40):
        pybullet.disconnect(client)
    assert where() == before


def test_loaded_policies_leave_the_exploration_type_as_it_was() -> None:
    policy, before = uavrl.load_policy("best"), exploration_type()
    seen = TensorDict({"observation": torch.zeros(1, policy.inputs)}, [1])
    acted = side_by_side(lambda _: policy(seen.clone())["action"], 60)
    assert exploration_type() is before
    assert all(torch.equal(action, acted[0]) for action in acted)


def test_configurations_are_composed() -> None:
    seeds = side_by_side(lambda number: compose(f"seed={number}").seed, 8)
    assert seeds == list(range(8))
    assert not GlobalHydra.instance().is_initialized()


def test_numpys_files_are_read_by_one_module_that_lets_threads_take_turns() -> None:
    """But for those of the process that reads a stranger's file."""
    readers = {
        path.name for path in (ROOT / "uavrl").rglob("*.py") if re.search(r"\bnp\.load\(", path.read_text("utf-8"))
    }
    assert readers == {"array_file.py", "shape_reader.py"}


def test_one_file_is_written_by_several_programs(tmp_path: Path) -> None:
    path = tmp_path / "result.json"

    def write(number: int) -> None:
        with replacing(path) as partial:
            partial.write_text(str(number) * 10_000)
            writable(path)  # which another program asks meanwhile
            assert partial.read_text() == str(number) * 10_000

    side_by_side(write, 10)
    text = path.read_text()
    assert len(text) == 10_000 and len(set(text)) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["result.json"]


def test_a_file_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with replacing(tmp_path / "ours") as partial:
        partial.write_text("ours")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_an_export_that_is_interrupted_leaves_no_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uavrl.evaluation.policies import PACKAGED
    from uavrl.export import export

    def interrupted(*_: object) -> bytes:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(export, "policy_onnx", interrupted)
        with pytest.raises(KeyboardInterrupt):
            export.export_policy(PACKAGED / "best", None, tmp_path / "mine")
    assert list((tmp_path / "mine").iterdir()) == []
    export.export_policy(PACKAGED / "best", None, tmp_path / "mine", network=False)
    assert {"contract.json", "policy.json", "config.yaml"} <= {each.name for each in (tmp_path / "mine").iterdir()}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_child_does_not_wait_for_a_thread_of_its_parent() -> None:
    lock, taken, leave = OneAtATime(), threading.Event(), threading.Event()

    def hold() -> None:
        with lock:
            taken.set()
            leave.wait(30)

    holder = threading.Thread(target=hold)
    holder.start()
    assert taken.wait(30)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads, which is what this is about
        child = os.fork()
    if child == 0:
        signal.alarm(20)
        with lock:
            os._exit(0)
    leave.set()
    holder.join()
    assert os.waitpid(child, 0)[1] == 0


def test_an_environment_may_act_in_a_thread_of_its_own_while_it_steps() -> None:
    policy = uavrl.load_policy("best")
    seen = TensorDict({"observation": torch.zeros(1, policy.inputs)}, [1])

    class Env:
        def step(self, state: TensorDict) -> TensorDict:
            with ThreadPoolExecutor(1) as thread:
                thread.submit(policy, seen.clone()).result(30)
            return state.set("next", state.clone())

    stepped = next(rollout(Env(), policy, seen.clone()))  # type: ignore[arg-type]
    assert "action" in stepped
