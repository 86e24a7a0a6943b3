"""A configuration names classes of the right kind from packages that are trusted, and nothing else."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from torch import nn
from torchrl.envs import EnvBase, Transform
from torchrl.record.loggers import Logger

from tests.helpers.configs import changed, composed
from uavrl.buffers import ABR, PrioritizedBuffer
from uavrl.config import conf_dir, validate
from uavrl.config.build import arguments, build, find_class
from uavrl.errors import UavrlError
from uavrl.losses import TD3Loss
from uavrl.models import Actor
from uavrl.transforms import TraditionalReward
from uavrl_onboard.ranges import Discount

REFUSED = [
    ("os.system", "os is no package that you have listed"),
    ("subprocess.Popen", "subprocess is no package"),
    ("builtins.eval", "builtins is no package"),
    ("torchrl.envs.llm.transforms.MCPToolTransform", "torchrl is no package"),  # which starts what it is told
    ("torchrl.modules.llm.TransformersWrapper", "torchrl is no package"),  # which loads what it is told
    ("torchrl.envs.transforms.R3MTransform", "torchrl is no package"),  # which unpickles what it is told
    ("torchrl.record.loggers.ray.RayLogger", "torchrl is no package"),
    ("torchrl.envs.GymEnv", "torchrl is no package"),  # which imports what it is told
    ("torch.nn.Linear", "torch is no package"),
    ("uavrl_evil.Reward", "uavrl_evil is no package"),
    ("uavrl.errors.signal.Signals", "there is no class"),
    ("uavrl.runs.folders.shutil.rmtree", "there is no class"),
    ("uavrl.runs.folders.made_folder", "there is no class"),
    ("uavrl.training.run.train", "there is no class"),
    ("uavrl.transforms.rewards.TradtionalReward", "did you mean TraditionalReward?"),
    ("uavrl..x", "which is no name of a class"),
    ("uavrl./proc/self/cwd/theirs.X", "which is no name of a class"),
    ("uavrl.models.actor critic.X", "which is no name of a class"),
    ("", "is no package"),
]


@pytest.mark.parametrize(("target", "said"), REFUSED, ids=lambda text: text)
def test_what_is_not_trusted_is_refused_before_it_is_imported(target: str, said: str) -> None:
    config = composed()
    config.reward._target_ = target
    with pytest.raises(UavrlError) as told:
        validate(config)
    assert said in str(told.value) and "reward._target_" in str(told.value)


@pytest.mark.parametrize(
    ("target", "kind"),
    [
        ("uavrl.losses.td3.TD3Loss", Transform),
        ("uavrl.envs.navigation.NavigationEnv", Transform),
        ("uavrl.transforms.rewards.traditional_reward", Transform),
        ("uavrl.transforms.rewards.TraditionalReward", EnvBase),
        ("uavrl.runs.folders.shutil.rmtree", Transform),
        ("uavrl.cli.train.Path", Logger),
        ("uavrl.training.run.torch.nn.Linear", nn.Module),  # a class of the right kind, by a way through ours
        ("uavrl.models.actor_critic.nn.Linear", nn.Module),
    ],
)
def test_what_is_of_another_kind_or_from_elsewhere_is_refused(target: str, kind: type) -> None:
    with pytest.raises(UavrlError):
        find_class(target, kind)


def test_a_class_that_ours_only_import_is_refused() -> None:
    with pytest.raises(UavrlError, match="torch is no package that you have listed"):
        find_class("uavrl.training.compiled.Tensor", object)


def test_a_package_that_the_user_lists_is_trusted() -> None:
    assert find_class("torch.nn.Linear", nn.Module, ["torch"]) is nn.Linear


def test_an_object_gets_what_is_written_and_what_it_names_of_what_is_offered() -> None:
    reward = build({"_target_": "uavrl.transforms.TraditionalReward", "arrived_reward": 7}, Transform, seed=3)
    assert isinstance(reward, TraditionalReward) and reward.arrived_reward == 7.0
    network = {"_target_": "uavrl.models.Actor", "hidden": [8]}
    actor = build(network, nn.Module, observations=6, actions=2, limit=1.0)
    assert isinstance(actor, Actor) and actor.net[0].out_features == 8 and actor.limit == 1.0
    assert build({"_target_": None}, Transform) is None


def test_what_a_constructor_refuses_is_one_sentence() -> None:
    with pytest.raises(UavrlError, match=r"uavrl.models.Actor cannot be made: .*observations"):
        build({"_target_": "uavrl.models.Actor"}, nn.Module)


# ---------------------------------------------------------------------- what constructors take


def test_arguments_are_those_of_the_class_and_of_its_bases_where_it_hands_on() -> None:
    assert {"gamma", "policy_noise", "action_spec", "delay_actor"} <= set(arguments(TD3Loss))  # the last is TorchRL's
    assert set(arguments(ABR)) == set(inspect.signature(ABR.__init__).parameters) - {"self"}
    assert arguments(PrioritizedBuffer)["frames"] is int
    assert arguments(TD3Loss)["gamma"] == Discount


def test_a_subclass_takes_what_its_base_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_rewards.py").write_text(
        "from __future__ import annotations\n"
        "from typing import TYPE_CHECKING\n"
        "from uavrl_onboard.ranges import Positive\n"
        "from uavrl.transforms import TraditionalReward\n"
        "if TYPE_CHECKING:\n"
        "    from elsewhere import Thing\n"
        "class Paid(TraditionalReward):\n"
        "    def __init__(self, *args, bonus: Positive = 1.0, thing: Thing = 1, **kwargs):\n"
        "        super().__init__(*args, **kwargs)\n"
        "class Same(Paid): pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    config = changed(["reward=traditional"])
    config.reward = {"_target_": "own_rewards.Same", "bonus": 2, "thing": [1, {"of": "any kind"}], "arrived_reward": 50}
    config.packages = ["own_rewards"]
    assert (reward := validate(config).reward).arrived_reward == 50.0
    assert (reward.bonus, reward.thing) == (2.0, [1, {"of": "any kind"}])
    config.reward.bonus = -1
    with pytest.raises(UavrlError, match=r"reward\.bonus must be above 0, got -1"):
        validate(config)
    config.reward.bonus, config.reward.arrived_reward = 2, "much"
    with pytest.raises(UavrlError, match=r"reward\.arrived_reward must be a number, got 'much'"):
        validate(config)


def test_what_is_not_trusted_is_refused_before_anything_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("stranger", "trusted"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    config = changed([])
    config.perception._target_, config.packages = "trusted.Perception", ["trusted"]
    config.env._target_ = "stranger.Env"
    with pytest.raises(UavrlError, match=r"env\._target_ names stranger\.Env, and stranger is no package"):
        validate(config)
    config.env._target_ = "uavrl.envs.navigation.NavigationEnv"
    with pytest.raises(SystemExit, match="imported"):
        validate(config)


def test_every_class_that_our_yaml_names_is_one() -> None:
    lines = [line for path in conf_dir().rglob("*.yaml") for line in path.read_text().splitlines()]
    named = {line.split("_target_:")[1].strip() for line in lines if "_target_:" in line} - {"null"}
    assert len(named) > 15
    assert all(find_class(target, object).__name__ in target for target in named)
