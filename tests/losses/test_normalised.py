"""What holds for all losses whose critics normalise their batches: CrossQ and XQC, of SAC and of TD3."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.helpers.normalised_losses import batch, crossq, crossq_td3, statistics, xqc, xqc_td3
from tests.helpers.runs import small_config
from tests.helpers.torchrl_losses import PENALTIES, activated
from uavrl.training.run import create_run, train


@pytest.mark.parametrize("make", [crossq, crossq_td3, xqc, xqc_td3])
@pytest.mark.parametrize("name", PENALTIES)
def test_penalties_attach_and_leave_the_statistics(make: type, name: str) -> None:
    torch.manual_seed(0)
    loss, data = activated(PENALTIES[name](make())), batch()
    data["next", "collided"] = data["next", "terminated"].clone()
    data["demonstrator_action"] = data["action"].flip(-1)
    loss.value_loss(data)
    before = statistics(loss)
    torch.manual_seed(1)
    with_term = loss.actor_loss(data)[0]
    torch.manual_seed(1)
    assert not torch.equal(with_term, loss.base.actor_loss(data)[0])
    torch.testing.assert_close(statistics(loss), before, atol=0, rtol=0)


@pytest.mark.parametrize(
    ("algo", "critic"),
    [
        ("crossq", ["hidden=[16]", "warmup=20"]),
        ("crossq_td3", ["hidden=[16]", "warmup=20"]),
        ("xqc", ["hidden=[16,16]", "atoms=11"]),
        ("xqc_td3", ["hidden=[16,16]", "atoms=11"]),
    ],
)
def test_a_run_with_all_the_rest(algo: str, critic: list[str], tmp_path: Path) -> None:
    """n-step targets, mirrored samples, a backward reward and priorities."""
    seen = ["perception=range_image", "perception.last_action=true", "buffer=prioritized", "buffer.mirror=true"]
    more = ["algo.n_steps=3", "backward_reward=abr", "trainer.episodes=8", *(f"algo.critic.{each}" for each in critic)]
    config = small_config(tmp_path / "run", f"algo={algo}", *seen, *more)
    summary = train(config, create_run(config))
    assert summary["updates"] > 20
