"""A package that uavrl knows nothing of brings a reward, an enhancer and an environment, and its user says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from torchrl.checkpoint import Checkpoint

from tests.helpers.commands import in_process
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command
from uavrl.runs.checkpoint import restore, rotation
from uavrl.training.stepper import ActorCriticStepper

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
    assert in_process(train_command.main, *CONFIG_DIR, TRUSTED, *CHOSEN, *SMALL, f"run_dir={tmp_path / 'run'}") == 0
    return tmp_path / "run"


def test_they_are_trained_from_the_command_line(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
