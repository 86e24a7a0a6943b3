"""Policies that are not ours fly in our evaluations: a model of Stable-Baselines3, and a class by its name."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.commands import in_process
from tests.helpers.configs import composed
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli.policies import file_of_policy
from uavrl.cli.suite import _changed
from uavrl.configs import EvaluateConfig, checked
from uavrl.errors import UavrlError

SHORT = ["episodes=2", "num_uavs=2", "env.max_steps=3", "progress=false"]
CLIMBER = '''
import torch


class Climber:
    """Climbs from the flight level, and does nothing else."""

    def __init__(self, flight_level: float = 0.0, speed: float = 2.0):
        assert flight_level == 3.5
        self.speed = speed

    def __call__(self, tensordict):
        action = torch.zeros(*tensordict.batch_size, 4)
        action[..., 2] = self.speed
        return tensordict.set("action", action)
'''


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A small untrained model of each kind that acts in another way: TD3 squashes its actions, PPO clips them."""
    sb3 = pytest.importorskip("stable_baselines3")
    import gymnasium

    class Empty(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (105,), np.float32)
        action_space = gymnasium.spaces.Box(-2.0, 2.0, (4,), np.float32)

    folder = tmp_path_factory.mktemp("models")
    for kind in (sb3.TD3, sb3.PPO):
        kind("MlpPolicy", Empty(), policy_kwargs={"net_arch": [8]}, seed=3).save(folder / kind.__name__)
    return {name: folder / f"{name}.zip" for name in ("TD3", "PPO")}


@pytest.mark.parametrize("name", ["TD3", "PPO"])
def test_a_model_of_stable_baselines_acts_as_in_its_own_library(models: dict[str, Path], name: str) -> None:
    import stable_baselines3 as sb3

    from uavrl.flying.stable_baselines import StableBaselinesPolicy

    states = torch.randn(5, 105)
    acted = StableBaselinesPolicy(models[name])(TensorDict({"observation": states}, [5]))["action"]
    expected, _ = getattr(sb3, name).load(models[name]).predict(states.numpy(), deterministic=True)
    np.testing.assert_array_equal(acted.numpy(), expected)
    with pytest.raises(UavrlError, match=r"reads states of shape \(105,\), got \(35,\)"):
        StableBaselinesPolicy(models[name])(TensorDict({"observation": states[:, :35]}, [5]))


def test_a_model_of_stable_baselines_is_evaluated_once_it_is_trusted(
    models: dict[str, Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    arguments = [f"policy='{models['TD3']}'", f"output={tmp_path / 'e.json'}", *SHORT]
    assert "add packages=[stable_baselines3]" in refused(evaluate_command.main, *arguments)
    assert in_process(evaluate_command.main, *arguments, "packages=[stable_baselines3]") == 0
    assert json.loads((tmp_path / "e.json").read_text())["policy"] == str(models["TD3"])


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 nothing"])
def test_a_file_that_is_no_model_is_named(content: bytes | None, tmp_path: Path, refused: Callable[..., str]) -> None:
    pytest.importorskip("stable_baselines3")
    path = tmp_path / "model.zip"
    if content is not None:
        path.write_bytes(content)
    assert str(path) in refused(evaluate_command.main, f"policy='{path}'", "packages=[stable_baselines3]", *SHORT)


def test_a_class_of_ones_own_is_evaluated_once_it_is_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str], capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my_policies.py").write_text(CLIMBER)
    monkeypatch.syspath_prepend(tmp_path)
    arguments = ["policy=my_policies.Climber", f"output={tmp_path / 'e.json'}", *SHORT]
    assert "add packages=[my_policies]" in refused(evaluate_command.main, *arguments)
    assert in_process(evaluate_command.main, *arguments, "packages=[my_policies]") == 0
    altitude = json.loads((tmp_path / "e.json").read_text())["whereabouts"]["altitude"]
    assert altitude["p95"] > altitude["p5"] + 0.05
    assert "uavrl-replay policy=my_policies.Climber 'packages=[my_policies]'" in capfd.readouterr().out


def test_a_policy_that_is_no_run_is_known_by_the_file_it_comes_from(
    models: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the suite flies again what has changed."""
    (tmp_path / "other_policies.py").write_text(CLIMBER)
    monkeypatch.syspath_prepend(tmp_path)
    assert file_of_policy("other_policies.Climber", ["other_policies"]) == tmp_path / "other_policies.py"
    assert file_of_policy(str(models["TD3"]), []) == models["TD3"]
    assert file_of_policy("nothing.zip", []) is None
    assert file_of_policy("straight", []) is None
    os.utime(tmp_path / "other_policies.py", (2_000_000_000, 2_000_000_000))
    named = composed("evaluate", "policy=other_policies.Climber", "packages=[other_policies]")
    assert _changed(checked(named, EvaluateConfig)) == 2_000_000_000


def test_what_is_no_policy_is_refused(refused: Callable[..., str]) -> None:
    said = refused(evaluate_command.main, "policy=uavrl.envs.lidar.LidarConfig", *SHORT)
    assert "must read a tensordict and write its action" in said
