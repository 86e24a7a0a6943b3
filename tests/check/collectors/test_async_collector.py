"""Flying in a process of its own: the same bookkeeping as in one process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import active_children
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from tests.helpers.runs import small_config
from uavrl.collectors.async_ import AsyncCollector
from uavrl.errors import UavrlError
from uavrl.runs.episodes import read_episodes
from uavrl.training.run import create_run, train


class Counter(EnvBase):
    """Counts to five; observes 0 in a process that never hears Ctrl-C, else 1. Breaks after ``breaks_after`` steps."""

    def __init__(self, breaks_after: int = 10**9) -> None:
        super().__init__()
        self.left = breaks_after
        self.observation_spec = Composite(observation=Unbounded((1,)))
        self.action_spec = Bounded(-1000.0, 1000.0, (1,))
        self.reward_spec = Unbounded((1,))
        self.count = 0

    def _reset(self, _: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        self.count = 0
        return TensorDict({"observation": self.disturbed()})

    def disturbed(self) -> torch.Tensor:
        return torch.tensor([float(signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, []))])

    def _step(self, data: TensorDictBase) -> TensorDictBase:
        self.count += 1
        self.left -= 1
        if self.left < 0:
            raise RuntimeError("a propeller came off")
        done = torch.tensor([self.count == 5])
        return TensorDict({"observation": self.disturbed(), "reward": torch.zeros(1), "done": done, "terminated": done})

    def _set_seed(self, seed: int | None) -> None:
        pass


class Breaking(Counter):
    def __init__(self) -> None:
        super().__init__(breaks_after=23)


def policy() -> TensorDictModule:
    return TensorDictModule(torch.nn.Linear(1, 1), ["observation"], ["action"])


def collector(env: type[EnvBase], actor: TensorDictModule, **more: int) -> AsyncCollector:
    whole = {"trajs_per_batch": 1, "traj_format": "cat"}
    return AsyncCollector(env, policy=actor, frames_per_batch=5, total_frames=-1, device="cpu", **whole, **more)


def test_whole_episodes_come_and_the_policy_follows_the_learners() -> None:
    actor = policy()
    flown = collector(Counter, actor)
    assert Counter().disturbed() == 1.0
    with torch.no_grad():
        actor.module.bias.fill_(99.0)  # as a checkpoint would
    try:
        actions = []
        for turn, batch in enumerate(flown):
            assert not batch["observation"].any()
            assert batch["next", "done"].flatten().tolist() == [False] * 4 + [True]
            actions.append(batch["action"][-1].item())
            with torch.no_grad():
                actor.module.bias.fill_(100.0 + turn)
            if turn == 8:
                break
        assert actions[0] == pytest.approx(99.0)
        assert all(a >= 100.0 for a in actions[3:])  # flown with what was learned meanwhile
        assert actions[3:] == sorted(actions[3:]) and actions[-1] > actions[3]
        assert flown.state_dict() == {"frames": 45, "iter": 8}
    finally:
        flown.shutdown()


class Seeded(Counter):
    """Observes the seed that it was given, modulo a million."""

    given = -1

    def _set_seed(self, seed: int | None) -> None:
        self.given = -1 if seed is None else seed % 10**6

    def disturbed(self) -> torch.Tensor:
        return torch.tensor([float(self.given)])


@pytest.mark.slow
def test_two_processes_fly_tasks_of_their_own() -> None:
    flown = collector(Seeded, policy(), processes=2)
    try:
        flown.restart(11, 100)
        seen = set()
        for turn, batch in enumerate(flown):
            assert batch["next", "done"].flatten().tolist() == [False] * 4 + [True]
            seen |= set(batch["observation"].flatten().tolist())
            if turn == 15:
                break
        assert 11.0 in seen and len(seen - {-1.0}) == 2
    finally:
        flown.shutdown()


def test_a_process_that_dies_ends_the_run_with_a_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    flown = collector(Breaking, policy())
    try:
        with pytest.raises(UavrlError, match="A process that flies has ended"):
            for _ in flown:
                time.sleep(0.2)  # so that it dies while the learner works
    finally:
        flown.shutdown(raise_on_error=False)
    assert "a propeller came off" in capfd.readouterr().err


def test_a_run_updates_as_often_as_it_steps_and_can_be_resumed(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "collector=async", "trainer.episodes=14")
    train(config, create_run(config))
    config.trainer.episodes = 22
    train(config, tmp_path / "run", resume=True)
    episodes = read_episodes(tmp_path / "run" / "episodes.csv")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert [e.episode for e in episodes] == list(range(1, 23))
    assert summary["steps"] == sum(e.steps for e in episodes) == episodes[-1].total_steps
    assert summary["updates"] == sum(e.steps for e in episodes if e.total_steps >= 40)


class Slow(Breaking):
    """Is built for as long as a large world is."""

    def __init__(self) -> None:
        time.sleep(600)
        super().__init__()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_does_not_wait_for_a_world_that_is_being_built(number: int) -> None:
    begun, others = time.monotonic(), active_children()
    before = signal.signal(number, signal.default_int_handler)
    signaller = threading.Timer(5.0, os.kill, (os.getpid(), number))
    try:
        signaller.start()
        with pytest.raises(KeyboardInterrupt):
            collector(Slow, policy())
    finally:
        signal.signal(number, before)
        signaller.join()
    assert set(active_children()) <= set(others) and time.monotonic() - begun < 300.0


STOPPED = """
import sys
from multiprocessing.process import BaseProcess
from pathlib import Path
from tests.helpers.runs import small_config
from uavrl.training import build, run

def stop(*about, **more):
    raise KeyboardInterrupt

if __name__ == "__main__":
    if sys.argv[2] == "flying":
        run.Progress.update = stop
    elif sys.argv[2] == "starting":
        start = BaseProcess.start
        BaseProcess.start = lambda process: (start(process), stop())
    else:
        build.EpisodeTrainer = stop
    config = small_config(Path(sys.argv[1]), "collector=async")
    try:
        run.train(config, run.create_run(config))
    except KeyboardInterrupt:
        print("stopped")
"""


@pytest.mark.slow
@pytest.mark.parametrize("when", ["flying", "starting", "built"])
def test_python_ends_after_a_training_that_was_stopped(when: str, tmp_path: Path) -> None:
    (tmp_path / "stopped.py").write_text(STOPPED)
    command = [sys.executable, tmp_path / "stopped.py", tmp_path / "run", when]
    root = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    ended = subprocess.run(command, env=root, capture_output=True, text=True, timeout=600, check=True)
    assert ended.stdout.endswith("stopped\n") and "leaked" not in ended.stderr
