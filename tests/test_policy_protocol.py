"""Everything that acts is a policy of one protocol."""

from __future__ import annotations

import numpy as np
import pytest
from tensordict import TensorDictBase

from uavrl.evaluation.guarded import GuardedPolicy
from uavrl.evaluation.policies import BASELINES, named_policy
from uavrl.policy_protocol import AdaptedPolicy, TensorDictPolicy, as_policy


class Remembers:
    """A policy that offers all that one may offer."""

    in_keys, out_keys, has_map, overrides = ["scan"], ["action", "risk"], True, {"perception.frames": 1}

    def __init__(self) -> None:
        self.last: np.ndarray | None = None

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict

    def flown(self, actions: np.ndarray) -> None:
        self.last = actions


@pytest.mark.parametrize("name", BASELINES)
def test_ours_offer_all_of_it_and_are_taken_as_they_are(name: str) -> None:
    policy = named_policy(name, {"flight_level": 3.5}, ())
    assert isinstance(policy, TensorDictPolicy) and not isinstance(policy, AdaptedPolicy)
    assert policy.in_keys and list(policy.out_keys) == ["action"] and policy.has_map == (name == "rrt_map")


def test_guards_pass_on_what_the_policy_offers() -> None:
    guarded, flown = GuardedPolicy(policy := Remembers()), np.zeros((1, 4))
    guarded.flown(flown)
    assert (guarded.in_keys, guarded.out_keys) == (["scan"], ["action", "risk"])
    assert (guarded.has_map, guarded.overrides) == (True, {"perception.frames": 1}) and policy.last is flown


def test_a_callable_keeps_what_it_offers_and_gets_defaults_for_the_rest() -> None:
    def reads_a_scan(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict

    reads_a_scan.in_keys = ["scan"]  # type: ignore[attr-defined]
    policy = as_policy(reads_a_scan)
    policy.flown(np.zeros((1, 4)))
    assert (list(policy.in_keys), list(policy.out_keys), policy.overrides) == (["scan"], ["action"], None)
