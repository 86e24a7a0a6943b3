"""Flying in Ray's workers: whole flights, counted right, each worker with tasks of its own, and one that dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.collectors.distributed import RayCollector as TorchRLRayCollector
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from tests.helpers.runs import SMALL, small_config
from uavrl.collectors.ray import RayCollector
from uavrl.errors import FlyingEnded, UavrlError
from uavrl.runs.episodes import read_episodes
from uavrl.training import run, trainer

ray = pytest.importorskip("ray")


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """One Ray for all tests here: starting it takes longer than they do."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    own = {"num_cpus": 2, "object_store_memory": 2**27, "include_dashboard": False, "logging_level": "error"}
    ray.init(address="local", _system_config={"worker_niceness": 0}, **own)  # else whatever runs beside stops them
    yield
    ray.shutdown()


class Counter(EnvBase):
    """Counts to five; observes the seed that it was given, modulo a thousand, and the process that it runs in."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_spec = Composite(observation=Unbounded((2,)))
        self.action_spec = Bounded(-1000.0, 1000.0, (1,))
        self.reward_spec = Unbounded((1,))
        self.count = self.seed = 0

    def seen(self) -> torch.Tensor:
        return torch.tensor([float(self.seed % 1000), float(os.getpid())])

    def _reset(self, _: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        self.count = 0
        return TensorDict({"observation": self.seen()})

    def _step(self, data: TensorDictBase) -> TensorDictBase:
        self.count += 1
        done = torch.tensor([self.count == 5])
        return TensorDict({"observation": self.seen(), "reward": torch.zeros(1), "done": done, "terminated": done})

    def _set_seed(self, seed: int | None) -> None:
        self.seed = seed or 0


class Policy(torch.nn.Module):
    """Answers with its only weight."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return self.weight.expand(*seen.shape[:-1], 1)


def collector(
    policy: Policy, workers: int = 2, init_random_frames: int = 0, env: type[EnvBase] | None = None
) -> RayCollector:
    actor = TensorDictModule(policy, ["observation"], ["action"])
    options = {"frames_per_batch": 5, "init_random_frames": init_random_frames}
    return RayCollector(env or Counter, actor, workers=workers, **options)


def test_whole_flights_come_from_every_worker_and_follow_the_learners_weights() -> None:
    policy = Policy()
    flown = collector(policy)
    try:
        flown.restart(11, 100)
        seeds: dict[float, set[float]] = {}
        actions: dict[float, list[float]] = {}
        for turn, flight in enumerate(flown):
            assert flight["next", "done"].flatten().tolist() == [False] * 4 + [True]
            seed, worker = flight["observation"][0].tolist()
            seeds.setdefault(worker, set()).add(seed)
            actions.setdefault(worker, []).append(flight["action"][0].item())
            with torch.no_grad():
                policy.weight.fill_(turn + 1.0)
            if turn >= 11 and len(actions) == 2 and min(map(len, actions.values())) > 3:  # one may be slow to begin
                break
        assert len(seeds) == 2  # processes
        assert len(set.union(*seeds.values())) == 2 and all(len(own) == 1 for own in seeds.values())
        for own in actions.values():
            assert own == sorted(own) and own[-1] > own[0]  # flown with what was learned meanwhile
        assert flown.state_dict() == {"frames": 5 * (turn + 1), "iter": turn + 1}
        flown.restart(12, 100)  # a checkpoint: those that fly go on
    finally:
        flown.shutdown()


def test_random_actions_are_flown_once_and_not_again_after_a_resume() -> None:
    flown = collector(Policy(), init_random_frames=40)
    try:
        flown.load_state_dict(OrderedDict(frames=30, iter=6))  # 15 of 20 each
        flown.restart(11, 100)
        actions: dict[float, list[list[float]]] = {}
        for turn, flight in enumerate(flown):
            actions.setdefault(flight["observation"][0, 1].item(), []).append(flight["action"].flatten().tolist())
            if turn >= 7 and len(actions) == 2:
                break
        assert len(actions) == 2
        (one, other) = (own[0] for own in actions.values())
        assert all(one) and all(other) and one != other  # five random actions, others in each worker
        assert all(flight == [0.0] * 5 for own in actions.values() for flight in own[1:])  # the policy's
    finally:
        flown.shutdown()


class Silent(Counter):
    """Breaks without a word."""

    def _step(self, data: TensorDictBase) -> TensorDictBase:
        raise AssertionError


@pytest.mark.slow
def test_a_worker_that_breaks_or_is_killed_ends_the_flying_with_a_sentence() -> None:
    broken = collector(Policy(), env=Silent)
    try:
        with pytest.raises(FlyingEnded, match=r"A process that flies has ended \(.+\); "):
            next(iter(broken))
    finally:
        broken.shutdown()
    flown = collector(Policy())
    try:
        with pytest.raises(FlyingEnded, match=r"A process that flies has ended \(.*died.*\); .*stands above"):
            for flight in flown:
                os.kill(int(flight["observation"][0, 1]), signal.SIGKILL)
    finally:
        flown.shutdown()


@pytest.mark.slow
def test_sigterm_ends_a_run_behind_a_checkpoint_and_ends_its_ray(tmp_path: Path) -> None:
    """Sent to all processes at once, as a cluster's scheduler does."""
    run_dir = tmp_path / "run"
    command = [sys.executable, "-m", "uavrl.cli.train", "collector=ray", f"run_dir={run_dir}", *SMALL]
    command += ["trainer.episodes=100000", "trainer.checkpoint_interval=10000000"]
    began = subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        until = time.monotonic() + 300
        csv = run_dir / "episodes.csv"
        while time.monotonic() < until and (not csv.exists() or len(csv.read_text().splitlines()) < 4):
            time.sleep(0.5)
        os.killpg(began.pid, signal.SIGTERM)
        said, _ = began.communicate(timeout=120)
    finally:
        if began.poll() is None:
            os.killpg(began.pid, signal.SIGKILL)
    assert began.returncode == 128 + signal.SIGTERM, said
    assert "which is saved: resume with uavrl-train resume=" in said
    assert len(list((run_dir / "checkpoints").glob("checkpoint*"))) == 2
    command = [sys.executable, "-m", "uavrl.cli.train", f"resume={run_dir}", "collector=ray", "collector.workers=1"]
    episodes = len(read_episodes(run_dir / "episodes.csv")) + 3
    subprocess.run([*command, f"trainer.episodes={episodes}"], check=True, capture_output=True, timeout=300)
    assert len(read_episodes(run_dir / "episodes.csv")) == episodes
    assert not [pid for pid in Path("/proc").glob("[0-9]*") if group(pid) == began.pid]  # nothing is left behind


def group(process: Path) -> int:
    """The process group, or 0 of one that has gone."""
    try:
        return os.getpgid(int(process.name))
    except OSError:
        return 0


@pytest.mark.slow
@pytest.mark.parametrize("flights", [0, 6, 12])
def test_a_run_keeps_what_it_learned_when_a_worker_dies_and_goes_on_with_fewer(flights: int, tmp_path: Path) -> None:
    config = small_config(
        tmp_path / "run", "collector=ray", "trainer.episodes=14", "trainer.checkpoint_interval=100000"
    )
    record = trainer.EpisodeTrainer.record
    begin = trainer.EpisodeTrainer.train

    def kill(flown: int) -> None:
        if flown == flights:
            os.kill(flying()[0], signal.SIGKILL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            trainer.EpisodeTrainer, "record", lambda self, batch: (record(self, batch), kill(self.episode_log.count))
        )
        patch.setattr(trainer.EpisodeTrainer, "train", lambda self: (kill(0), begin(self)))
        with pytest.raises(FlyingEnded, match="A process that flies has ended"):
            run.train(config, run.create_run(config))
    before = read_episodes(tmp_path / "run" / "episodes.csv")
    assert flights <= len(before) < 14

    config.collector.workers = 1
    run.train(config, tmp_path / "run", resume=True)
    episodes = read_episodes(tmp_path / "run" / "episodes.csv")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert episodes[: len(before)] == before  # each flight that was learned from is kept
    assert [episode.episode for episode in episodes] == list(range(1, 15))
    assert summary["steps"] == sum(episode.steps for episode in episodes) == episodes[-1].total_steps
    assert summary["updates"] == sum(episode.steps for episode in episodes if episode.total_steps >= 40)
    starts = [(episode.start_x, episode.start_y, episode.goal_x, episode.goal_y) for episode in episodes]
    assert len(set(starts)) == len(starts)  # no task is flown twice


def flying() -> list[int]:
    """The processes of this process's own Ray that fly."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            is_worker = (process / "cmdline").read_bytes().lower().startswith(b"ray::worker")
            if is_worker and parent(parent(int(process.name))) == os.getpid():
                found.append(int(process.name))
        except OSError:
            continue
    return found


def parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_a_cluster_without_enough_processors_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", lambda **_: None)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    with pytest.raises(UavrlError, match="asks for 3 processors, and the Ray cluster has 2"):
        collector(Policy(), workers=3)


def test_a_ray_that_was_left_is_not_started_again_to_end_its_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray starts anew at any call; a collector that is thrown away ends the workers that it still has."""
    made, called = list[RayCollector](), list[str]()

    def interrupted(self: RayCollector, *_: object, **__: object) -> None:
        self._remote_collectors = ["one", "two"]
        made.append(self)
        raise KeyboardInterrupt

    monkeypatch.setattr(TorchRLRayCollector, "__init__", interrupted)
    monkeypatch.setattr("uavrl.collectors.ray._connect", lambda *_: True)
    monkeypatch.setattr(ray, "shutdown", lambda: called.append("shutdown"))
    monkeypatch.setattr(ray, "kill", lambda worker, **_: called.append(worker))
    with pytest.raises(KeyboardInterrupt):
        collector(Policy())
    made[0].__del__()
    assert called == ["shutdown"]
