"""Compiled updates of critics whose statistics move."""

from __future__ import annotations

import pytest
import torch

from tests.losses.test_crossq import batch, crossq, crossq_td3
from uavrl.training.update import ActorCriticStepper


@pytest.mark.parametrize("make", [crossq, crossq_td3])
def test_compiled_updates_move_the_statistics_as_eager_ones_do(make: type) -> None:
    found = []
    for execution in ("eager", "compiled"):
        torch.manual_seed(0)
        loss = make(warmup=3)
        stepper = ActorCriticStepper(loss, execution=execution, policy_delay=2)
        for _ in range(6):
            stepper.step(None, batch())
        state = loss.qvalue_network_params.flatten_keys(".").items()
        found.append({key: value.clone() for key, value in state if "running" in key or "batches" in key})
        assert all((value == 6).all() for key, value in found[-1].items() if "batches" in key)
    torch.testing.assert_close(*found, atol=1e-3, rtol=1e-3)
