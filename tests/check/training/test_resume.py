"""A killed and resumed run is bit-identical to one that was never stopped."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from tests.helpers.commands import DEFAULT_VALLEY
from tests.helpers.runs import ABR, FORK_AND_LIFEGUARD, SAC, SMALL, assert_same_run, contents, small_config
from tests.helpers.signals import hearing
from uavrl.buffers import GatheringStorage
from uavrl.errors import UavrlError
from uavrl.pretraining import read_states
from uavrl.runs.checkpoint import rotation
from uavrl.runs.episodes import read_episodes
from uavrl.training.run import create_run, train

PRIORITIZED = ["buffer=prioritized"]
DDPG = ["algo=ddpg"]
DYNAMIC = [*DEFAULT_VALLEY, "env=dynamic", "perception.lidar.dropout=0.1"]
RANDOMIZED = [*DEFAULT_VALLEY, "randomize=real", "env.max_steps=30"]  # longer than any delay
SEEN = ["perception=range_image", "perception.last_action=true", "buffer.mirror=true"]
DECAY = ["actor_penalty.final_weight=0.2", "actor_penalty.decay_steps=400", "smoothness=action_rate"]
GUIDED = ["demonstrator=vfh", "actor_penalty=imitation", *DECAY, "algo.learning_starts=60", *SEEN]

CLONED = [  # and TD3 after that
    *("cloning=dagger", "cloning.steps=120", "cloning.batch_size=16", "cloning.critic_updates=5"),
    *GUIDED,
]
RECURRENT = [  # clones another demonstrator, then learns as CLONED does, on windows, with critics that know more
    *(each.replace("demonstrator=vfh", "demonstrator=vfh_mapped") for each in CLONED),
    "recurrent=gru",
    "recurrent.size=8",
    "recurrent.burn_in=3",
    "recurrent.length=4",
    "perception.frames=1",
    "algo.n_steps=3",
    "algo.critic_reads=[clearance,planes,wind,mapped_way]",
]

VALIDATED = ["validation=unseen", "validation.interval=30", "validation.tasks=2", "validation.seeds=[7]"]

CROSSQ = ["algo=crossq_td3", "algo.critic.hidden=[16]", "algo.critic.warmup=20", "algo.n_steps=3"]
XQC = ["algo=xqc", "algo.critic.hidden=[16,16]", "algo.critic.atoms=11", *SEEN]

WHOLE = ["trainer.episodes=16", "logger.interval=1"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[list[str]], Path]:
    """Gives the folder of a run that was never stopped; each is trained once."""

    @cache
    def trained(overrides: tuple[str, ...]) -> Path:
        config = small_config(tmp_path_factory.mktemp("whole") / "run", *WHOLE, *overrides)
        train(config, create_run(config))
        return Path(config.run_dir)

    return lambda overrides: trained(tuple(overrides))


def test_the_penalties_have_their_say_in_these_runs(whole: Callable[[list[str]], Path]) -> None:
    for name in ("lifeguard_active", "lifeguard_penalty", "fork_gate", "fork_weight"):
        (log,) = (whole(FORK_AND_LIFEGUARD) / "logs").rglob(f"{name}.csv")
        assert max(float(line.split(",")[-1]) for line in log.read_text().splitlines()) > 0, name


def last_values(run_dir: Path, *names: str) -> list[float]:
    logs = [next((run_dir / "logs").rglob(f"{name}.csv")) for name in names]
    return [float(log.read_text().splitlines()[-1].split(",")[-1]) for log in logs]


def test_flights_that_arrive_are_paid_again(whole: Callable[[list[str]], Path]) -> None:
    run = whole(ABR)
    episodes, extra, values = last_values(run, "backward_episodes", "backward_extra", "backward_values")
    arrived = sum(episode.outcome == "arrived" for episode in read_episodes(run / "episodes.csv"))
    assert episodes == arrived > 1
    assert extra > 0 and values > 1


def test_abr_plus_runs_with_the_artifact_of_the_package(tmp_path: Path) -> None:
    overrides = ["trainer.episodes=4", "logger.interval=1", "backward_reward=abr_plus", "env.world.goal_radius=12"]
    config = small_config(tmp_path / "run", *overrides)
    train(config, create_run(config))
    assert last_values(tmp_path / "run", "backward_seconds")[0] > 0


def test_pretraining_finds_every_state_of_a_run_that_was_resumed(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "trainer.episodes=8")
    train(config, create_run(config))
    before = read_states(tmp_path / "run")
    train(OmegaConf.merge(config, {"trainer": {"episodes": 12}}), tmp_path / "run", resume=True)
    after, episodes = read_states(tmp_path / "run"), read_episodes(tmp_path / "run/episodes.csv")
    assert after.outcomes == [episode.outcome for episode in episodes]
    assert np.bincount(after.episode).tolist() == [episode.steps for episode in episodes]
    assert (after.states[: len(before)] == before.states).all()


def test_abr_takes_states_of_any_number_of_frames_but_one(tmp_path: Path) -> None:
    config = small_config(tmp_path / "four", *ABR, "perception.frames=4", "trainer.episodes=2")
    train(config, create_run(config))
    config = small_config(tmp_path / "one", *ABR, "perception.frames=1")
    with pytest.raises(UavrlError, match=r"perception\.frames must be at least 2, got 1"):
        train(config, create_run(config))


@pytest.mark.parametrize(
    "overrides",
    [FORK_AND_LIFEGUARD, *(pytest.param(o, marks=pytest.mark.slow) for o in (DYNAMIC, PRIORITIZED, DDPG, SAC, ABR))],
)
def test_two_runs_are_bit_identical(tmp_path: Path, whole: Callable[[list[str]], Path], overrides: list[str]) -> None:
    """The plain one is flown twice below, where one is killed."""
    config = small_config(tmp_path / "run", *WHOLE, *overrides)
    train(config, create_run(config))
    assert_same_run(whole(overrides), tmp_path / "run")


@pytest.mark.parametrize(
    "overrides",
    [
        *(
            [],
            FORK_AND_LIFEGUARD,
            PRIORITIZED,
            ABR,
            DYNAMIC,
            RANDOMIZED,
            GUIDED,
            CLONED,
            RECURRENT,
            VALIDATED,
            CROSSQ,
            XQC,
        ),
        *(pytest.param(o, marks=pytest.mark.slow) for o in (DDPG, SAC)),
    ],
)
def test_a_resumed_run_is_bit_identical(
    tmp_path: Path, whole: Callable[[list[str]], Path], overrides: list[str]
) -> None:
    cut = Path(shutil.copytree(whole(overrides), tmp_path / "run"))
    # Go back: as if the process had been killed after the second checkpoint, with rows written since.
    checkpoints = rotation(cut).checkpoints()
    assert len(checkpoints) >= 4
    for later in checkpoints[2:]:
        later.unlink()
    (cut / "summary.json").unlink()
    with (cut / "episodes.csv").open("a") as file:
        file.write("17,9,arri")
    with next((cut / "logs").rglob("return.csv")).open("a") as file:
        file.write("9999,0.")
    foreign = cut / "logs/run/scalars/smoothed.csv"
    foreign.write_text("step,value\n9999,0\n")
    train(small_config(cut, *WHOLE, *overrides), cut, resume=True)
    assert foreign.read_text() == "step,value\n9999,0\n"
    foreign.unlink()
    assert_same_run(whole(overrides), cut)


class WholeStates(GatheringStorage):
    """Keeps every state as it is sampled."""

    frame_bytes = 0

    def __init__(self, capacity: int, frames: int, device: str) -> None:
        super().__init__(capacity, device=device)


def test_states_kept_frame_by_frame_teach_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = ["buffer=prioritized", "buffer.capacity=70"]  # overwritten meanwhile
    for name in ("frames", "whole"):
        config = small_config(tmp_path / name, "trainer.episodes=10", *small)
        with monkeypatch.context() as patch:
            if name == "whole":
                patch.setattr("uavrl.buffers.replay.FrameStorage", WholeStates)
            train(config, create_run(config))
    assert (tmp_path / "frames/episodes.csv").read_bytes() == (tmp_path / "whole/episodes.csv").read_bytes()
    frames, whole = (contents(rotation(tmp_path / name).latest()) for name in ("frames", "whole"))
    learned = [name for name in frames if "/storage/" not in name]
    assert len(learned) > 30
    assert not [name for name in learned if frames[name] != whole[name]]


def test_a_stopped_run_says_how_to_go_on_and_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "uavrl.cli.train", *SMALL, "trainer.episodes=5000", f"run_dir={tmp_path / 'run'}"]
    with hearing(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 400
        while len(rotation(tmp_path / "run").checkpoints() if (tmp_path / "run").exists() else ()) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=400)
    assert process.returncode == 130
    (told,) = [line for line in err.splitlines() if "are still being built" not in line]  # as they are at times
    assert told.startswith("uavrl: stopped after episode ") and f"uavrl-train resume={tmp_path / 'run'}" in told
