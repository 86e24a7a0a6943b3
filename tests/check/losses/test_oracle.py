"""Whole updates of the library in single precision against a plain PyTorch implementation of the same equations."""

from __future__ import annotations

import pytest
import torch
import torch._inductor.config

from tests.helpers.against_oracle import CASES, RECORDED, compare_updates, trained
from uavrl.training.compiled import Execution

# The wide one would hold to 3e-6, too close to the limit for every machine.
SINGLE = [name for name in CASES if name != "td3_wide"]


@pytest.mark.parametrize("name", SINGLE)
@pytest.mark.parametrize("execution", ["captured", pytest.param("eager", marks=pytest.mark.slow)])
def test_updates_are_those_of_plain_pytorch(name: str, execution: Execution) -> None:
    compare_updates(name, execution, torch.float32)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_compiled_updates_are_eager_ones(name: str) -> None:
    with torch._inductor.config.patch(fallback_random=True):  # else the kernels draw noise of their own
        eager, compiled = (trained(RECORDED[name], execution) for execution in ("eager", "compiled"))
    for key, value in eager.items():
        torch.testing.assert_close(compiled[key], value, atol=1e-5, rtol=1e-5, msg=f"{{}} ({key})".format)
