"""Whoever configures TorchRL's own trainers by Hydra finds our transforms and losses in the same groups.

In a process of its own: to Hydra a node of TorchRL's is the schema of a file of ours that has its name.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CONFIG = """
defaults:
  - transform@first: uavrl_truncated_icosahedron
  - transform@then: step_counter
  - loss@learner: uavrl_ddpg_loss
  - _self_
first: {radius: 2.5}
learner: {gamma: 0.9}
"""
SCRIPT = """
import sys
import torchrl.trainers.algorithms.configs
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.utils import instantiate
from tensordict.nn import TensorDictModule
from uavrl.models import Actor, Critic
from uavrl.training.torchrl_groups import GROUPS, register_in_torchrl

register_in_torchrl()
with initialize_config_dir(sys.argv[1], version_base="1.3"):
    config = compose("config")
first, then = instantiate(config.first), instantiate(config.then)
actor = TensorDictModule(Actor(6, 2, (8,)), ["observation"], ["action"])
critic = TensorDictModule(Critic(6, 2, (8,)), ["observation", "action"], ["state_action_value"])
loss = instantiate(config.learner, actor_network=actor, value_network=critic)
print(type(first).__module__, first.radius, type(then).__name__)
print(type(loss).__module__, round(float(loss.value_estimator.gamma), 3))
for group, members in GROUPS.items():
    stored = [name for name in ConfigStore.instance().list(group) if name.startswith("uavrl_")]
    print(group, len(stored) == len(members) > 0)
"""


def test_ours_stand_beside_torchrls_and_are_built_from_there(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(CONFIG)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)], capture_output=True, text=True, check=False, timeout=600
    )
    assert done.stdout.splitlines() == [
        "uavrl.transforms.icosahedron 2.5 StepCounter",
        "uavrl.losses.ddpg 0.9",
        "transform True",
        "loss True",
    ], done.stderr
