"""What can be set on a penalty: its own settings and those of the loss below, and nothing that has no effect."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from torchrl.envs.utils import ExplorationType

from tests.helpers.losses import SPEC, episodes, fork, lifeguard, sac, td3, trained
from tests.helpers.torchrl_losses import BASES
from uavrl.losses import ActionRate, ActorPenalty, Imitation, LifeGuard
from uavrl.models import RewardNet


def test_a_threshold_is_one_attribute() -> None:
    """It opened nothing when it was set on the loss, and not on its gate."""
    loss = fork(td3(), threshold=0.1)
    loss.update_gate(0.5)
    assert not loss.active
    loss.threshold = 1.0
    assert loss.gate.threshold == loss.threshold == 1.0
    loss.update_gate(0.5)
    assert loss.active
    loss.gate.threshold = 0.2
    assert loss.threshold == 0.2


def test_weights_follow_the_settings_at_once() -> None:
    guard = lifeguard(success_window=4)
    guard.observe(torch.cat([episodes(3), episodes(1, collided=False, arrived=True)]))
    guard.penalty_weight = 2.0
    assert guard.weight.item() == pytest.approx(1.5)
    ahead = fork(td3(), base_weight=0.6)
    ahead.base_weight = 0.5
    assert ahead.weight.item() == pytest.approx(0.5)
    cloned = Imitation(td3(), limit=2.0, weight=4.0, final_weight=1.0, decay_steps=10)
    cloned.observe(episodes(1))  # half of the steps
    assert cloned.weight.item() == pytest.approx(2.0)
    cloned.first_weight = 9.0
    assert cloned.weight.item() == pytest.approx(3.0)


def test_without_a_success_window_the_weight_follows_too() -> None:
    loss = lifeguard(success_window=None)
    loss.penalty_weight = 3.0
    assert loss.weight.item() == 3.0


def test_a_lower_bar_activates_at_once() -> None:
    loss = trained(lifeguard(), rounds=8)
    loss.min_evaluations = 1000
    assert not loss.active
    loss.min_evaluations = 0
    assert loss.active


@pytest.mark.parametrize(
    ("make", "name", "message"),
    [
        (lambda: lifeguard(), "weight", "computed from penalty_weight"),
        (lambda: fork(td3()), "weight", "computed from base_weight"),
        (lambda: Imitation(td3()), "weight", "computed from first_weight"),
        (lambda: lifeguard(), "capacity", "only when it is made: make a new one with capacity="),
        (lambda: lifeguard(), "stacked", "only when it is made"),
        (lambda: fork(td3()), "return_window", "only when it is made"),
        (lambda: fork(td3()), "max_rewards", "did you mean max_reward"),
        (lambda: ActionRate(td3(), actions=2), "wieght", "did you mean weight"),
        (lambda: lifeguard(BASES["td3"]()), "no_such_setting", "Neither LifeGuard nor the loss below"),
    ],
)
def test_what_would_move_nothing_is_refused(make: Any, name: str, message: str) -> None:
    loss = make()
    with pytest.raises(AttributeError, match=message):
        setattr(loss, name, 7.0)
    with pytest.raises(AttributeError, match=message):
        setattr(copy.deepcopy(loss), name, 7.0)


def test_what_the_loss_below_has_is_read_and_set_there() -> None:
    loss = lifeguard(fork(BASES["sac"]()))
    assert loss.loss_function == "smooth_l1" and loss.log_alpha is loss.unwrapped.log_alpha
    loss.loss_function = "l2"
    loss.threshold = 0.5
    loss.alpha_init = 2.0
    assert (loss.unwrapped.loss_function, loss.base.gate.threshold) == ("l2", 0.5)
    assert loss.unwrapped.alpha_init.item() == 2.0
    assert "loss_function" not in vars(loss) and "threshold" not in vars(loss)
    with pytest.raises(AttributeError, match="no_such_attribute"):
        _ = loss.no_such_attribute


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reduction", "sum"),
        ("use_prioritized_weights", False),
        ("loss_mask_key", "mask"),
        ("deterministic_sampling_mode", ExplorationType.MEAN),
    ],
)
@pytest.mark.parametrize("base", [td3, BASES["td3"]])
def test_a_setting_of_all_losses_is_that_of_the_loss_below(base: Any, name: str, value: object) -> None:
    loss = Imitation(lifeguard(base()))
    setattr(loss, name, value)
    assert getattr(loss, name) == getattr(loss.base, name) == getattr(loss.unwrapped, name) == value
    setattr(loss.unwrapped, name, value)


def test_a_subclass_without_a_constructor_is_complete_too() -> None:
    class Mine(ActionRate):
        pass

    class Other(ActionRate):
        def __init__(self, base: Any, *, more: float) -> None:
            super().__init__(base, actions=2)
            self.more = more  # after the constructor above has ended

    for loss in (Mine(td3(), actions=2), Other(td3(), more=1.0)):
        loss.weight = 0.5
        with pytest.raises(AttributeError, match="Neither"):
            loss.mre = 1.0
    assert isinstance(loss, ActorPenalty) and loss.more == 1.0


def test_networks_of_a_penalty_are_its_own_and_those_below_come_through() -> None:
    loss = LifeGuard(fork(sac()), observations=6, actions=2)
    assert loss.reward_network_params is loss.base.reward_network_params
    assert loss.target_qvalue_network_params is loss.unwrapped.target_qvalue_network_params
    assert loss.alpha_params == [loss.unwrapped.log_alpha]
    assert isinstance(loss.reward_network.module, RewardNet) and SPEC.shape == (2,)
