"""A package that uavrl knows nothing of brings a reward, an enhancer, a perception and an environment."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from torchrl.checkpoint import Checkpoint
from torchrl.envs import CatTensors, Compose, TransformedEnv

from tests.helpers.commands import in_process
from tests.helpers.finished import finished_run
from tests.helpers.flights import small_env, unpack
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import replay as replay_command
from uavrl.cli import train as train_command
from uavrl.envs import NavigationEnv
from uavrl.errors import UavrlError
from uavrl.flying.record import reduction_of
from uavrl.flying.recording import RecordedFlight, load_recording
from uavrl.reporting.flight_page import page_data
from uavrl.runs.checkpoint import restore, rotation
from uavrl.training.stepper import ActorCriticStepper
from uavrl.transforms import NavigationReward, TruncatedIcosahedron

OWN = Path(__file__).resolve().parents[1] / "examples/own_parts"
CONFIG_DIR, TRUSTED = ["--config-dir", str(OWN / "conf")], "packages=[own_parts]"
CHOSEN = ["env=corridor", "reward=hurry", "enhancer=calm"]
SMALL = [
    "trainer.episodes=6",
    "trainer.progress=false",
    "trainer.execution=eager",
    "trainer.products=mkl",
    "algo.random_steps=20",
    "algo.hidden=[8]",
    "buffer.capacity=400",
]


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(OWN)


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    return finished_run(tmp_path / "run", *CONFIG_DIR, TRUSTED, *CHOSEN, *SMALL)


def test_they_are_trained_from_the_command_line(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    summary = json.loads((run_dir / "summary.json").read_text())
    assert (summary["env"], summary["learner"], summary["reward"]) == ("corridor", "td3_calm", "hurry")
    assert summary["episodes"] == 6 and summary["updates"] > 0
    written = yaml.safe_load((run_dir / "config.yaml").read_text())
    assert written["env"]["_target_"] == "own_parts.env.Corridor"
    seen = []
    step = ActorCriticStepper.step
    monkeypatch.setattr(
        ActorCriticStepper, "step", lambda self, *arguments: seen.append(type(self.loss)) or step(self, *arguments)
    )
    resumed = in_process(train_command.main, f"resume={run_dir}", TRUSTED, "trainer.episodes=7")
    assert resumed == 0 and {kind.__name__ for kind in seen} == {"Calm"}
    assert in_process(evaluate_command.main, f"run={run_dir}", TRUSTED, "episodes=2", "progress=false") == 0
    assert json.loads((run_dir / "evaluation_episodes=2.json").read_text())["env"] == "corridor"
    sentence = refused(evaluate_command.main, f"run={run_dir}", TRUSTED, "episodes=2", "env=bipedal_hardcore")
    assert "The policy and env=bipedal_hardcore do not go together (" in sentence  # states of 2 numbers, and of 24


def test_a_reduction_that_uavrl_knows_nothing_of_is_flown_with_and_replayed(tmp_path: Path) -> None:
    run = f"run_dir={tmp_path / 'run'}"
    little = [*SMALL[1:], "trainer.episodes=2", "env.num_uavs=2", "env.max_steps=20", "env.world.obstacles=5"]
    chosen = ["perception=sectors", "perception.frames=2", "backward_reward=abr", run]
    assert in_process(train_command.main, *CONFIG_DIR, TRUSTED, *little, *chosen) == 0
    watched = [
        "task=1",
        f"output={tmp_path / 'page.html'}",
        f"data={tmp_path / 'flights.npz'}",
        "points=100000",
        "progress=false",
    ]
    assert in_process(replay_command.main, f"run={tmp_path / 'run'}", TRUSTED, *watched) == 0
    recording = load_recording(tmp_path / "flights.npz")
    (flight,), (place,) = recording.flights, recording.sceneries.values()
    assert flight.faces.shape[1:] == (8,) and flight.observations.shape[1:] == (2 * (8 + 3),)
    assert place.directions.shape == (8, 3) and place.statistic == "proximity"
    assert set(unpack(page_data(recording)["ball"]["faces"]).tolist()) == set(range(8))
    np.testing.assert_allclose(flight.faces, sectors_of(flight), atol=1e-5)


def sectors_of(flight: RecordedFlight) -> np.ndarray:
    """The same from the points."""
    told = np.zeros((len(flight.times), 8))
    for moment, row in enumerate(told):
        for x, y, z in flight.cloud(moment):
            sector = round(math.atan2(y, x) / (math.pi / 4)) % 8
            row[sector] = max(row[sector], 4.0 - math.sqrt(x * x + y * y + z * z))
    return told


def test_a_replay_asks_for_cells_that_can_be_drawn() -> None:
    env = TransformedEnv(NavigationEnv(1, world=small_env().world), NavigationReward())
    with pytest.raises(UavrlError, match=r"draws the cells of a uavrl\.transforms\.PointCloudReduction, and this"):
        reduction_of(env)
    dropped = CatTensors(["faces", "altitude"], "observation")
    env = TransformedEnv(NavigationEnv(1, world=small_env().world), Compose(TruncatedIcosahedron(), dropped))
    with pytest.raises(UavrlError, match=r"TruncatedIcosahedron, and this perception drops \['point_cloud', 'faces'\]"):
        reduction_of(env)


class Optimisers:
    """Takes what a checkpoint has of the stepper."""

    def state_dict(self) -> dict[str, Any]:
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.found = state_dict


@pytest.mark.parametrize("execution", ["eager", "captured"])
def test_a_model_that_uavrl_knows_nothing_of_is_trained_and_goes_on_with_its_run(
    execution: str, tmp_path: Path
) -> None:
    chosen = [*CHOSEN[:2], "enhancer=wary", *SMALL, f"trainer.execution={execution}", f"run_dir={tmp_path / 'run'}"]
    assert in_process(train_command.main, *CONFIG_DIR, TRUSTED, *chosen) == 0
    assert in_process(train_command.main, f"resume={tmp_path / 'run'}", TRUSTED, "trainer.episodes=9") == 0
    optimisers = Optimisers()
    restore(Checkpoint(stepper=optimisers), rotation(tmp_path / "run").latest(), ["stepper"])
    updates = json.loads((tmp_path / "run/summary.json").read_text())["updates"]
    adam = optimisers.found["model_optimizer_0"]
    assert updates > 0 and [float(state["step"]) for state in adam["state"].values()] == [updates] * 4
    assert adam["param_groups"][0]["lr"] == 1e-3


def test_a_run_that_names_them_does_not_make_them_trusted(run_dir: Path, refused: Callable[..., str]) -> None:
    written = (run_dir / "config.yaml").read_text()
    assert yaml.safe_load(written)["packages"] == ["own_parts"]
    told = "own_parts is no package that you have listed: if you trust its code, add packages=[own_parts]"
    assert told in refused(train_command.main, f"resume={run_dir}", "trainer.episodes=9")
    assert told in refused(evaluate_command.main, f"run={run_dir}", "episodes=2", "progress=false")
    assert (run_dir / "config.yaml").read_text() == written


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("reward.prize=0", "reward.prize must be above 0, got 0.0"),
        ("enhancer.weight=much", "enhancer.weight must be a number, got 'much'"),
        ("+env.lenght=3", "There is no key 'env.lenght': did you mean env.length?"),
        ("reward=traditional", "The reward reads 'distance', which Corridor does not emit"),
        ("env._target_=own_parts.env.Corridors", "there is no class own_parts.env.Corridors: did you mean Corridor?"),
        ("env._target_=own_parts.reward.HurryReward", "There is no key 'env.length'"),
    ],
)
def test_their_mistakes_are_one_sentence_too(
    override: str, said: str, tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused(train_command.main, *CONFIG_DIR, TRUSTED, *CHOSEN, *SMALL, override)
    assert not list(tmp_path.iterdir())
