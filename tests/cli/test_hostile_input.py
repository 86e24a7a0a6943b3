"""What a newcomer mistypes and what an enemy gives: one sentence that names it, and nothing left behind."""

from __future__ import annotations

import logging
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from omegaconf import DictConfig

from tests.helpers.commands import TINY, in_process
from tests.helpers.configs import composed
from tests.helpers.measured import measured
from uavrl.cli import train as train_command
from uavrl.cli.memory import require_memory
from uavrl.collectors.stall_notice import StallNotice
from uavrl.config import validate
from uavrl.envs.gym import ValleyEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.quadrotor import Aerodynamics, Airframe
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.training.loggers import require_login
from uavrl.transforms import TruncatedIcosahedron
from uavrl.transforms.icosahedron import truncated_icosahedron

MISTAKES = {
    "algo.gama=0.9": "There is no key 'algo.gama': did you mean algo.gamma?",
    "+algo.gama=0.9": "There is no key 'algo.gama'",
    "algo.actor._target_=uavrl.models.actor_critic.Critic": "algo.actor must be a network that takes an observation",
    "device=cuda:99": "CUDA devices: use device=cpu",
    "device=meta": "device must be auto, cpu, cuda or cuda:<index>, got 'meta'",
    "env.world.min_clearance=9": "min_clearance",
    "episodes=60": "did you mean trainer.episodes?",
    "reward_preset=t": "reward_preset must be one of abr, abr_plus",
    "learner=td3_lg fork=on": "learner=td3_lg selects fork=none, but the command line selects fork=on",
    "reward_preset=tr reward=navigation": "selects reward=traditional, but the command line selects reward=navigation",
    "backward_reward=none reward_preset=abr": "selects backward_reward=abr, but the command line selects backward_rew",
    "algo=null": "Config group override must be a string",
    "lifeguard.capacity=3": "lifeguard.capacity belongs to another choice of lifeguard than the one made",
    "algo.gamma=[1": "The override 'algo.gamma=[1' cannot be read",
    "run_dir=": "run_dir must be a folder to make, got ''",
    "resume=": "resume must be the folder of a run, got ''",
    "env.airframe.inertia=[1,1]": "uavrl: env.airframe.inertia must be a list of 3, got [1, 1]",
    "env.aerodynamics.wind=[1]": "uavrl: env.aerodynamics.wind must be a list of 3, got [1]",
    "perception.lidar.dropout=1": "uavrl: perception.lidar.dropout must be a probability in [0, 1), got 1.0",
    "perception.radius=1e30": "perception.radius must be in (0, 100], got 1e+30",
    "env.world.size=[1e9,1e9]": "uavrl: env.world.size and ceiling must make at most 200,000 m³ of a valley",
    "env.world.obstacles=1000000000": "uavrl: env.world.obstacles must be at most 2,000 in a valley",
    "env.world.obstacle_scale=1e6": "lower obstacles or obstacle_scale",
    "env.airframe.collision_radius=100": "uavrl: env.airframe.collision_radius and half of airframe.collision_height",
    "env.airframe.mass=-1": "uavrl: env.airframe: Mass, inertia, arm",
    "trainer.updates_per_step=1e9": "trainer.updates_per_step must be in (0, 100], got 1000000000.0",
    "trainer.threads=1000000": "trainer.threads must be in [1, 256], got 1000000",
    "trainer.window=10000000000000000000000": "trainer.window must be at most 1e+15",
    "env.num_uavs=1000000000": "env.num_uavs must be in [1, 512], got 1000000000",
    "buffer.capacity=100000000000": "for buffer.capacity=100000000000, and this machine has",
    "algo.hidden=[1000000,1000000]": "for algo.hidden=[1000000, 1000000], and this machine has",
    "algo.batch_size=1000000000": "lower algo.batch_size.",
    "lifeguard=linear lifeguard.capacity=100000000000": "lower lifeguard.capacity.",
    "fork=on fork.system_network.hidden=[1000000,1000000]": "lower fork.system_network.hidden.",
}


@pytest.mark.parametrize("arguments", MISTAKES)
def test_a_mistake_is_one_sentence_and_leaves_no_folder(
    arguments: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert MISTAKES[arguments] in refused(train_command.main, *arguments.split())
    assert not list(tmp_path.iterdir())


def test_a_mistake_found_after_the_folder_was_made_leaves_none(tmp_path: Path, refused: Callable[..., str]) -> None:
    run_dir = tmp_path / "runs" / "new" / "run"
    assert "CUDA devices" in refused(train_command.main, *TINY, "device=cuda:99", f"run_dir={run_dir}")
    assert not (tmp_path / "runs").exists()
    run_dir.mkdir(parents=True)
    (run_dir / "mine.txt").write_text("kept")
    assert "CUDA devices" in refused(train_command.main, *TINY, "device=cuda:99", f"run_dir={run_dir}")
    assert (run_dir / "mine.txt").read_text() == "kept"


# ---------------------------------------------------------------------- short runs


@pytest.mark.parametrize(("learning_starts", "warned"), [(500, True), (0, False)])
def test_a_run_that_learns_nothing_says_so_first_and_last(
    learning_starts: int, warned: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    overrides = [*TINY, f"run_dir={tmp_path / 'run'}", f"algo.learning_starts={learning_starts}"]
    assert in_process(train_command.main, *overrides) == 0
    told = capfd.readouterr().err
    assert ("algo.learning_starts=500: nothing is learned before" in told) == warned
    assert ("Nothing was learned: the run ended after" in told) == warned


# ---------------------------------------------------------------------- memory and time


def test_an_ordinary_training_fits_into_a_gigabyte_and_ten_times_its_buffer_does_not() -> None:
    require_memory(validate(composed()), memory=1e9)
    large = validate(composed("config", "buffer.capacity=10000000"))
    with pytest.raises(UavrlError, match=r"about 2 GB of memory, 2 GB of it for buffer\.capacity=10000000"):
        require_memory(large, memory=1e9)


@measured
def test_a_long_silence_is_explained_once_and_a_short_one_never(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with StallNotice(lambda: "Waiting for an episode.", seconds=0.3) as stall_notice:
        for said in ([], ["Waiting for an episode."], ["Waiting for an episode."] * 2):
            assert caplog.messages == said
            for _ in range(10 if not said else 0):
                time.sleep(0.05)
                stall_notice.reset()
            assert caplog.messages == said
            stall_notice.reset()
            time.sleep(0.6)
    time.sleep(0.4)
    assert len(caplog.messages) == 3


# ---------------------------------------------------------------------- disk and account


def test_a_full_disk_names_the_file_and_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    run_dir = tmp_path / "run"
    sentence = refused(train_command.main, *TINY, f"run_dir={run_dir}")
    assert f"{run_dir / 'episodes.csv'} cannot be written (No space left on device)" in sentence
    assert f"resume with uavrl-train resume={run_dir}" in sentence
    monkeypatch.undo()
    assert in_process(train_command.main, f"resume={run_dir}") == 0


def test_a_checkpoint_is_not_begun_where_it_has_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    """What tensordict maps into memory would end the process by SIGBUS."""
    left = iter([10**9, 10**9, *[10_000] * 9])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=next(left)))
    run_dir = tmp_path / "run"
    sentence = refused(train_command.main, *TINY, f"run_dir={run_dir}", "trainer.episodes=50")
    assert f"{run_dir} cannot be written" in sentence and "MB are needed and 0.0 MB are left" in sentence
    assert f"resume with uavrl-train resume={run_dir}" in sentence
    assert len(list((run_dir / "checkpoints").iterdir())) == 2


def test_wandb_without_a_login_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    wandb = pytest.importorskip("wandb")

    def no_login(*_: object, **__: object) -> None:
        raise wandb.errors.UsageError("No API key configured. Use `wandb login` to log in.")

    run_dir = tmp_path / "run"
    asked = [*TINY, "logger=wandb", "logger.offline=false"]
    for place in ("login", "init"):  # no login, and one that the server refuses
        with monkeypatch.context() as patch:
            patch.setattr(wandb, "login", lambda **_: True)
            patch.setattr(wandb, place, no_login)
            if place == "login":  # found before a folder is made, or is looked at to go on
                patch.setattr("uavrl.training.run.create_run", pytest.fail)
            sentence = refused(train_command.main, *asked, f"run_dir={run_dir}")
        assert "logger=wandb could not begin (No API key configured" in sentence and "wandb login" in sentence
        assert not list(tmp_path.iterdir())


def wandb_logger(offline: bool) -> DictConfig:
    return validate(composed("config", "logger=wandb", f"logger.offline={offline}")).logger


def test_wandb_needs_a_key_online_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    require_login(wandb_logger(offline=True))
    for name in ("WANDB_API_KEY", "WANDB_MODE", "WANDB_IDENTITY_TOKEN_FILE"):
        monkeypatch.delenv(name, raising=False)
    for name in ("NETRC", "WANDB_CONFIG_DIR", "WANDB_CACHE_DIR", "WANDB_DATA_DIR", "WANDB_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    with pytest.raises(UavrlError, match=r"logger=wandb could not begin \(No API key .* log in with wandb login"):
        require_login(wandb_logger(offline=False))


# ---------------------------------------------------------------------- the library


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: WorldConfig(size=(1e9, 1e9)), "lower size"),
        (lambda: WorldConfig(seeds=tuple(range(1000))), "give fewer seeds"),
        (lambda: WorldConfig(planes=10**9), "planes must be at most 100"),
        (lambda: Airframe(inertia=(1.0, 1.0)), "inertia takes three numbers"),
        (lambda: Aerodynamics(force_coefficients=()), "force_coefficients takes three numbers"),
        (lambda: LidarConfig(max_range=1e30), "max_range must be a positive length in metres, at most"),
        (lambda: truncated_icosahedron([[1.0, 2.0, 3.0]]), "points must be a tensor .* got a list"),
        (lambda: truncated_icosahedron(torch.zeros(1, 3), radius=1e30), "radius must be a positive length"),
        (lambda: truncated_icosahedron(torch.zeros(1, 3), radius="a"), "radius must be a positive length.* got 'a'"),
        (lambda: TruncatedIcosahedron(radius=None), "radius must be a positive length.* got None"),
    ],
)
def test_the_library_refuses_by_one_sentence(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize("action", [[1.0, 2.0, 3.0], [[0.0] * 4] * 2, 0.0])
def test_an_action_of_another_shape_is_refused(action: object) -> None:
    env = ValleyEnv(world=WorldConfig(obstacles=5))
    env.reset(seed=0)
    with pytest.raises(UavrlError, match="An action is 4 numbers"):
        env.step(action)
    env.close()
