"""Whoever configures TorchRL's own trainers by Hydra finds our transforms and losses in the same groups."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.utils import instantiate
from tensordict.nn import TensorDictModule
from torchrl.envs import StepCounter

from uavrl.losses import DDPGLoss
from uavrl.models import Actor, Critic
from uavrl.training.torchrl_groups import GROUPS, register_in_torchrl
from uavrl.transforms import TruncatedIcosahedron

torchrl_configs = pytest.importorskip("torchrl.trainers.algorithms.configs")


def test_ours_stand_beside_torchrls_and_are_built_from_there(tmp_path: Path) -> None:
    register_in_torchrl()
    (tmp_path / "config.yaml").write_text(
        "defaults:\n"
        "  - transform@first: uavrl_truncated_icosahedron\n"
        "  - transform@then: step_counter\n"
        "  - loss@learner: uavrl_ddpg_loss\n"
        "  - _self_\n"
        "first: {radius: 2.5}\n"
        "learner: {gamma: 0.9}\n"
    )
    with initialize_config_dir(str(tmp_path), version_base="1.3"):
        config = compose("config")
    first, then = instantiate(config.first), instantiate(config.then)
    assert isinstance(first, TruncatedIcosahedron) and first.radius == 2.5
    assert isinstance(then, StepCounter)
    actor = TensorDictModule(Actor(6, 2, (8,)), ["observation"], ["action"])
    critic = TensorDictModule(Critic(6, 2, (8,)), ["observation", "action"], ["state_action_value"])
    loss = instantiate(config.learner, actor_network=actor, value_network=critic)
    assert isinstance(loss, DDPGLoss)
    assert float(loss.value_estimator.gamma) == pytest.approx(0.9)
    assert loss.actor_network_params.values(True, True) and torch.is_tensor(next(loss.parameters()))


def test_every_one_has_a_node() -> None:
    register_in_torchrl()
    for group, members in GROUPS.items():
        stored = [name for name in ConfigStore.instance().list(group) if name.startswith("uavrl_")]
        assert len(stored) == len(members)
