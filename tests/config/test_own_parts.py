"""A package that uavrl knows nothing of brings a reward, an actor penalty, a perception and an environment."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from torchrl.envs import CatTensors, Compose, TransformedEnv

from tests.helpers.commands import in_process
from tests.helpers.finished import finished_run
from tests.helpers.flights import small_env
from tests.helpers.own_parts import CHOSEN, CONFIG_DIR, SMALL, TRUSTED
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import train as train_command
from uavrl.envs import NavigationEnv
from uavrl.errors import UavrlError
from uavrl.evaluation.record import reduction_of
from uavrl.training.update import ActorCriticStepper
from uavrl.transforms import NavigationReward, TruncatedIcosahedron


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
    sentence = refused(evaluate_command.main, f"run={run_dir}", TRUSTED, "episodes=2", "env=static")
    assert "The policy reads 'observation', which NavigationEnv does not emit" in sentence


def test_a_replay_asks_for_cells_that_can_be_drawn() -> None:
    env = TransformedEnv(NavigationEnv(1, world=small_env().world), NavigationReward())
    with pytest.raises(UavrlError, match=r"draws the cells of a uavrl\.transforms\.PointCloudReduction, and this"):
        reduction_of(env)
    dropped = CatTensors(["faces", "altitude"], "observation")
    env = TransformedEnv(NavigationEnv(1, world=small_env().world), Compose(TruncatedIcosahedron(), dropped))
    with pytest.raises(UavrlError, match=r"TruncatedIcosahedron, and this perception drops \['point_cloud', 'faces'\]"):
        reduction_of(env)


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
        ("reward.prize=0", "reward.prize must be above 0, got 0"),
        ("actor_penalty.weight=much", "actor_penalty.weight must be a number, got 'much'"),
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
