"""Compiled updates of critics that give distributions."""

from __future__ import annotations

import torch

from tests.losses.test_xqc import BOTH, batch, row_norms
from uavrl.training.update import ActorCriticStepper


@BOTH
def test_compiled_updates_move_statistics_and_norms_as_eager_ones_do(make: type) -> None:
    found = []
    for execution in ("eager", "compiled"):
        torch.manual_seed(0)
        loss = make()
        stepper = ActorCriticStepper(loss, execution=execution, policy_delay=2)
        for _ in range(6):
            stepper.step(None, batch())
        for norms in row_norms(loss):
            torch.testing.assert_close(norms, torch.ones_like(norms))
        found.append(
            {
                f"{name}.{key}": value.clone()
                for name in ("qvalue_network_params", "target_qvalue_network_params")
                for key, value in getattr(loss, name).flatten_keys(".").items()
                if "running" in key or "batches" in key
            }
        )
        assert all((value == 6).all() for key, value in found[-1].items() if "batches" in key)
    torch.testing.assert_close(*found, atol=1e-3, rtol=1e-3)
