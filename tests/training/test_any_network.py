"""The stepper against TD3 and SAC in plain PyTorch, with networks that the library has never seen: captured updates."""

from __future__ import annotations

import pytest
import torch

from tests.helpers.any_network import CRITICS, compare_updates


@pytest.mark.parametrize("make", CRITICS)
@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_updates_are_those_of_plain_pytorch(algo: str, make: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compare_updates(algo, make, "captured", torch.float64, monkeypatch)
