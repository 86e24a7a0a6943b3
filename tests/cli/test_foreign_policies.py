"""Policies that are not ours fly in our evaluations: a model of Stable-Baselines3, and a class by its name."""

from __future__ import annotations

import base64
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from tensordict import TensorDict

from tests.helpers.commands import in_process
from tests.helpers.configs import composed
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli.suite import _changed
from uavrl.config import EvaluateConfig, validate
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import file_of_policy
from uavrl.evaluation.sb3 import StableBaselinesPolicy

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


class Empty(gymnasium.Env):
    """As wide as the valley, and like it: most cells of three frames are empty, altitude and angles of any sign."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (105,), np.float32)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (4,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        return self._seen(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        return self._seen(), 0.0, False, False, {}

    def _seen(self) -> np.ndarray:
        seen = self.np_random.uniform(0.5, 1.0, (3, 35)) * (self.np_random.random((3, 35)) < 0.2)
        seen[:, 32:] = self.np_random.uniform(-1.0, 1.0, (3, 3))
        return seen.ravel().astype(np.float32)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A small untrained model of each kind that acts in another way: TD3 squashes its actions, PPO clips them."""
    folder = tmp_path_factory.mktemp("models")
    for kind in (sb3.TD3, sb3.PPO):
        kind("MlpPolicy", Empty(), policy_kwargs={"net_arch": [8]}, seed=3).save(folder / kind.__name__)
    return {name: folder / f"{name}.zip" for name in ("TD3", "PPO")}


@pytest.mark.parametrize("name", ["TD3", "PPO"])
def test_a_model_of_stable_baselines_acts_as_in_its_own_library(models: dict[str, Path], name: str) -> None:
    states = torch.randn(5, 105)
    acted = StableBaselinesPolicy(models[name])(TensorDict({"observation": states}, [5]))["action"]
    expected, _ = getattr(sb3, name).load(models[name]).predict(states.numpy(), deterministic=True)
    np.testing.assert_array_equal(acted.numpy(), expected)
    with pytest.raises(UavrlError, match=r"reads states of shape \(105,\), got \(35,\)"):
        StableBaselinesPolicy(models[name])(TensorDict({"observation": states[:, :35]}, [5]))


def learned(name: str, path: Path) -> tuple[Any, VecNormalize]:
    """A model that has learned a few steps in a VecNormalize, saved, and that VecNormalize."""
    env = VecNormalize(DummyVecEnv([Empty]))
    few = {"n_steps": 32, "batch_size": 32, "n_epochs": 1} if name == "PPO" else {"learning_starts": 100}
    model = getattr(sb3, name)("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, seed=3, **few).learn(64)
    model.save(path)
    return model, env


@pytest.mark.parametrize("name", ["TD3", "PPO"])
def test_a_model_reads_normalized_observations_only_if_its_statistics_are_given(name: str, tmp_path: Path) -> None:
    model, env = learned(name, tmp_path / "model.zip")
    env.save(str(tmp_path / "vecnormalize.pkl"))
    states = torch.rand(5, 105)
    given = {None: states.numpy(), tmp_path / "vecnormalize.pkl": env.normalize_obs(states.numpy())}
    acted = []
    for file, seen in given.items():
        policy = StableBaselinesPolicy(tmp_path / "model.zip", file)
        acted.append(policy(TensorDict({"observation": states}, [5]))["action"].numpy())
        np.testing.assert_array_equal(acted[-1], model.predict(seen, deterministic=True)[0])
    assert np.abs(acted[0] - acted[1]).max() > 1e-3


class Recurrent(ActorCriticPolicy):
    """Returns a state beside its actions, as the policies of RecurrentPPO do."""

    def predict(self, *args: Any, **kwargs: Any) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        return super().predict(*args, **kwargs)[0], (np.zeros(1),)


def test_a_recurrent_model_is_refused(tmp_path: Path) -> None:
    sb3.PPO(Recurrent, Empty(), policy_kwargs={"net_arch": [8]}).save(tmp_path / "model.zip")
    with pytest.raises(UavrlError, match=r"model.zip has a recurrent policy, whose state an evaluation would not keep"):
        StableBaselinesPolicy(tmp_path / "model.zip")


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("exploded"),)


def test_statistics_are_opened_once_the_model_is_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    learned("TD3", tmp_path / "model.zip")
    Path("statistics.pkl").write_bytes(pickle.dumps(Bomb()))
    given = ["policy=model.zip", "vecnormalize=statistics.pkl", *SHORT]
    assert "add packages=[stable_baselines3]" in refused(evaluate_command.main, *given)
    assert not Path("exploded").exists()


def test_statistics_of_a_policy_that_is_no_model_are_refused(refused: Callable[..., str]) -> None:
    said = refused(evaluate_command.main, "policy=best", "vecnormalize=statistics.pkl", *SHORT)
    assert "vecnormalize must be left out unless policy=MODEL.zip is given, got 'statistics.pkl'" in said


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "is no file"), (b"nothing", "cannot be opened"), (pickle.dumps([1.0]), r"of shape \(105,\) in")],
)
def test_statistics_that_are_none_are_named(
    models: dict[str, Path], content: bytes | None, told: str, tmp_path: Path
) -> None:
    file = tmp_path / "statistics.pkl"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(UavrlError, match=rf"{told}.*statistics.pkl|statistics.pkl.*{told}"):
        StableBaselinesPolicy(models["TD3"], file)


def test_statistics_of_observations_of_another_width_are_named(models: dict[str, Path], tmp_path: Path) -> None:
    env: Any = VecNormalize(DummyVecEnv([Empty]))
    env.observation_space = type(env.observation_space)(-1.0, 1.0, (35,))
    (tmp_path / "statistics.pkl").write_bytes(pickle.dumps(env))
    with pytest.raises(UavrlError, match=r"of shape \(105,\) in .*statistics.pkl"):
        StableBaselinesPolicy(models["TD3"], tmp_path / "statistics.pkl")


def rewritten(source: Path, target: Path, changes: dict[str, Callable[[str], str]]) -> Path:
    """A copy of a model whose texts are changed."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, changes[name](content.decode()) if name in changes else content)
    return target


def pickled_elsewhere(key: str) -> Callable[[str], str]:
    """The model's data with a value whose pickle names a module that is not there."""
    gone = base64.b64encode(b"cnumpy._core_of_another_time\nthing\n.").decode()

    def change(data: str) -> str:
        return json.dumps({**json.loads(data), key: {":type:": "x", ":serialized:": gone}})

    return change


def test_a_model_of_other_versions_names_them_where_it_cannot_be_opened(
    models: dict[str, Path], tmp_path: Path
) -> None:
    older = "- OS: Linux-5.15 # 66\n- Python: 3.8.10\n- Stable-Baselines3: 1.6.2\n- Numpy: 1.21.0\n"
    changes = {"data": pickled_elsewhere("observation_space"), "system_info.txt": lambda _: older}
    saved, here = "Stable-Baselines3 1.6.2 and NumPy 1.21.0", f"Stable-Baselines3 {sb3.__version__} and NumPy "
    with pytest.raises(UavrlError, match=f"saved with {saved}, and cannot be opened with {here}{np.__version__}"):
        StableBaselinesPolicy(rewritten(models["TD3"], tmp_path / "older.zip", changes))
    del changes["system_info.txt"]
    with pytest.raises(UavrlError, match=r"is no model that Stable-Baselines3 saved \(No module named 'numpy"):
        StableBaselinesPolicy(rewritten(models["TD3"], tmp_path / "damaged.zip", changes))


def test_what_flying_does_not_need_of_a_model_is_not_unpickled(models: dict[str, Path], tmp_path: Path) -> None:
    """Schedules are what breaks between versions of Python."""
    path = rewritten(models["PPO"], tmp_path / "m.zip", {"data": pickled_elsewhere("lr_schedule")})
    states = TensorDict({"observation": torch.randn(5, 105)}, [5])
    acted = [StableBaselinesPolicy(model)(states.clone())["action"] for model in (models["PPO"], path)]
    assert torch.equal(*acted)


def test_a_model_of_stable_baselines_is_evaluated_once_it_is_trusted(
    models: dict[str, Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    arguments = [f"policy='{models['TD3']}'", f"output={tmp_path / 'e.json'}", *SHORT]
    assert "add packages=[stable_baselines3]" in refused(evaluate_command.main, *arguments)
    assert in_process(evaluate_command.main, *arguments, "packages=[stable_baselines3]") == 0
    assert json.loads((tmp_path / "e.json").read_text())["policy"] == str(models["TD3"])


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 nothing"])
def test_a_file_that_is_no_model_is_named(content: bytes | None, tmp_path: Path, refused: Callable[..., str]) -> None:
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
    altitude = json.loads((tmp_path / "e.json").read_text())["position_stats"]["altitude"]
    assert altitude["p95"] > altitude["p5"] + 0.05
    told = capfd.readouterr().out
    assert "uavrl-replay policy=my_policies.Climber 'packages=[my_policies]' env.max_steps=3\n" in told


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
    assert _changed(validate(named, EvaluateConfig)) == 2_000_000_000
    named = composed("evaluate", f"policy='{models['TD3']}'", f"vecnormalize='{tmp_path / 'other_policies.py'}'")
    assert _changed(validate(named, EvaluateConfig)) == 2_000_000_000


def test_what_is_no_policy_is_refused(refused: Callable[..., str]) -> None:
    said = refused(evaluate_command.main, "policy=uavrl.envs.lidar.LidarConfig", *SHORT)
    assert "must read a tensordict and write its action" in said
