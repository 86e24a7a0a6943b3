"""Everything that acts is a policy of one protocol."""

from __future__ import annotations

import numpy as np
import pytest
from tensordict import TensorDictBase

from uavrl.evaluation.policies import BASELINES, named_policy
from uavrl.policy_protocol import AdaptedPolicy, TensorDictPolicy, as_policy


@pytest.mark.parametrize("name", BASELINES)
def test_ours_offer_all_of_it_and_are_taken_as_they_are(name: str) -> None:
    policy = named_policy(name, {"flight_level": 3.5}, ())
    assert isinstance(policy, TensorDictPolicy) and not isinstance(policy, AdaptedPolicy)
    assert policy.in_keys and list(policy.out_keys) == ["action"] and policy.has_map == (name == "rrt_map")


def test_a_callable_keeps_what_it_offers_and_gets_defaults_for_the_rest() -> None:
    def reads_a_scan(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict

    reads_a_scan.in_keys = ["scan"]  # type: ignore[attr-defined]
    policy = as_policy(reads_a_scan)
    assert policy.recurrent_state is None
    policy.flown(np.zeros((1, 4)))
    assert (list(policy.in_keys), list(policy.out_keys), policy.overrides) == (["scan"], ["action"], None)
    reads_a_scan.recurrent_state = (1, 8)  # type: ignore[attr-defined]
    assert as_policy(reads_a_scan).recurrent_state == (1, 8), "an environment carries it"
