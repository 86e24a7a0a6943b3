"""The stepper against TD3 and SAC in plain PyTorch, with networks that the library has never seen."""

from __future__ import annotations

import pytest
import torch

from tests.helpers.any_network import CRITICS, compare_updates
from uavrl.training.compiled import Execution

# Captured updates are eager ones bit for bit, as test_oracle.py holds; the compiled ones take long.
QUICK = [("td3", "TorchRL's", execution, torch.float32) for execution in ("eager", "compiled")]
CASES = [
    pytest.param(
        algo,
        make,
        execution,
        dtype,
        id=f"{algo}-{make}-{execution}-{str(dtype)[6:]}",
        marks=[] if execution == "captured" or (algo, make, execution, dtype) in QUICK else [pytest.mark.slow],
    )
    for algo in ("td3", "sac")
    for make in CRITICS
    for execution in ("eager", "captured", "compiled")
    for dtype in (torch.float32, torch.float64)
    if (execution, dtype) != ("captured", torch.float64)  # those are quick
]


@pytest.mark.parametrize(("algo", "make", "execution", "dtype"), CASES)
def test_updates_are_those_of_plain_pytorch(
    algo: str, make: str, execution: Execution, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare_updates(algo, make, execution, dtype, monkeypatch)
