"""Whole updates of the library against a plain PyTorch implementation of the same equations."""

from __future__ import annotations

import pytest
import torch

from tests.helpers.against_oracle import CASES, RECORDED, compare_updates, trained


@pytest.mark.parametrize("name", CASES)
def test_updates_are_those_of_plain_pytorch(name: str) -> None:
    """In double precision, and captured; tests/check has single precision and other executions."""
    compare_updates(name, "captured", torch.float64)


@pytest.mark.parametrize("name", RECORDED)
def test_captured_updates_are_eager_ones_bit_for_bit(name: str) -> None:
    eager, captured = (trained(RECORDED[name], execution) for execution in ("eager", "captured"))
    assert eager.keys() == captured.keys()
    assert [key for key in eager if not torch.equal(eager[key], captured[key])] == []
