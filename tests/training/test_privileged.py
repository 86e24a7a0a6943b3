"""Critics read what the environment emits for them; policies and what is exported of them never do."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from tests.helpers.commands import VALLEY
from tests.helpers.configs import composed
from tests.helpers.exported import exported
from uavrl.config import validate
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss
from uavrl.losses.networks import make_actor, network_sizes
from uavrl.training.build import make_buffer, make_loss, make_training_env, make_windows
from uavrl.training.replay import EpisodeReplay

READS = "algo.critic_reads=[planes,velocity,clearance,wind]"
SMALL = [
    *VALLEY,
    "env.num_uavs=2",
    "env.max_steps=6",
    "env.world.planes=1",
    "env.world.plane_keep_out=1",
    "algo.hidden=[8]",
    "run_dir=here",
]
GRU = ["recurrent=gru", "recurrent.size=4", "recurrent.burn_in=2", "recurrent.length=2"]
CPU = torch.device("cpu")


def settings_of(*overrides: str) -> TrainConfig:
    return validate(composed("config", *SMALL, *overrides))


def learner(*overrides: str) -> tuple[ActorCriticLoss, TensorDict]:
    """A loss with the batch that it learns from, of what the environment emits."""
    settings = settings_of(*overrides)
    env = make_training_env(settings, seed=0)
    sizes = network_sizes(env)
    torch.manual_seed(0)
    loss = make_loss(settings, make_actor(settings, sizes), sizes, CPU)
    buffer = make_buffer(settings, env, sizes, CPU)
    replay = EpisodeReplay(buffer, 6, windows=make_windows(settings, buffer, loss))
    flown = env.rollout(6, break_when_any_done=False)
    replay.store(
        replay.filtered(torch.cat([episode[: int(episode["next", "done"].int().argmax()) + 1] for episode in flown]))
    )
    env.close()
    (batch,) = replay.batches(1)
    return loss, batch


@pytest.mark.parametrize("algo", ["td3", "sac"])
@pytest.mark.parametrize("more", [[], GRU], ids=["transitions", "windows"])
def test_the_critics_values_change_with_it_and_the_policys_action_does_not(algo: str, more: list[str]) -> None:
    loss, batch = learner(f"algo={algo}", READS, *more)
    steps = batch["steps"] if more else batch
    assert steps["privileged"].shape[-1] == steps["next", "privileged"].shape[-1] == 18 + 3 + 1 + 3
    found: list[tuple[torch.Tensor, ...]] = []
    for part in ((), ("privileged",), ("next", "privileged")):
        changed = batch.clone()
        if part:
            (changed["steps"] if more else changed).get(part).add_(1.0)
        torch.manual_seed(1)
        value, metadata = loss.value_loss(changed)
        action = loss.act(loss.states(changed))["action"] if algo == "td3" else metadata["target_value"]
        found.append((metadata["pred_value"], metadata["target_value"], action, value))
    (now, then, action, value), (changed_now, _, same, _), (_, changed_then, _, _) = found
    assert not torch.equal(now, changed_now)
    assert not torch.equal(then, changed_then)
    assert torch.equal(action, same)
    assert value.isfinite()


def test_what_is_exported_is_the_same(tmp_path: Path) -> None:
    for name, reads in (("plain", []), ("more", [READS])):
        exported(tmp_path / name, *SMALL[:-1], *reads)
    plain, more = (json.loads((tmp_path / name / "exported/contract.json").read_text()) for name in ("plain", "more"))
    assert plain == more, "same weights, network, inputs and scales"


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ([READS, "fork=on"], "fork must be none with recurrent=gru or algo.critic_reads"),
        ([*GRU, "fork=on"], "fork must be none with recurrent=gru or algo.critic_reads"),
        ([READS, "perception=range_image", "buffer.mirror=true"], "no mirror image of velocity is known"),
        (["algo.critic_reads=[sun]"], "The critic reads 'sun', which NavigationEnv does not emit"),
        *(
            ([f"algo.critic_reads=[{key}]", "buffer.mirror=false"], f"The critic reads '{key}', which NavigationEnv")
            for key in ("action", "reward", "done", "terminated")
        ),
        (["algo.critic_reads=[wind,wind]"], "algo.critic_reads must be different names"),
        ([*GRU, "algo=ddpg"], "algo must be td3 or sac with a memory"),
        ([*GRU, "buffer=prioritized"], "buffer must be uniform with a memory"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_sentence(overrides: list[str], said: str) -> None:
    with pytest.raises(UavrlError) as caught:
        learner(*overrides)
    assert str(caught.value).startswith(said) or said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("demonstrator", "read"),
    [
        ("vfh_privileged", {"way", "planes"}),
        ("vfh_mapped", {"mapped_way"}),
        ("vfh_mapped_traps", {"mapped_way", "traps"}),
    ],
)
def test_a_demonstrator_may_read_what_the_policy_never_does(demonstrator: str, read: set[str]) -> None:
    told = [f"demonstrator={demonstrator}", "perception=range_image", "perception.last_action=true"]
    env = make_training_env(settings_of(*told), seed=0)
    flown = env.rollout(3, policy=env.rand_action, break_when_any_done=False)
    sizes = network_sizes(env)
    assert {*read, "demonstrator_action"} <= set(flown["next"].keys())
    assert flown["observation"].shape[-1] == sizes.state and sizes.privileged == 0
    plain = make_training_env(settings_of(*told[1:], "demonstrator=vfh"), seed=0)
    assert network_sizes(plain) == sizes and read.isdisjoint(plain.reset().keys())
    env.close(), plain.close()


def test_critics_and_the_demonstrator_may_read_different_quantities() -> None:
    told = ["demonstrator=vfh_privileged", "perception=range_image", "perception.last_action=true"]
    env = make_training_env(settings_of(*told, "algo.critic_reads=[wind,way]"), seed=0)
    first = env.reset()
    torch.testing.assert_close(first["privileged"], torch.cat([first["wind"] / 5, first["way"]], -1))
    env.close()
