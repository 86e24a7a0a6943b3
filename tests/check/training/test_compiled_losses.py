"""Losses under torch.compile give what they give without."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

import pytest
import torch
import torch._dynamo
import torch._inductor.config

import tests.losses
from tests.helpers.contracts import LossContract

for module in pkgutil.iter_modules(tests.losses.__path__, "tests.losses."):
    importlib.import_module(module.name)


def contracts(above: type[LossContract] = LossContract) -> Iterator[type[LossContract]]:
    """Those that make a loss: their names begin as pytest's do."""
    for contract in above.__subclasses__():
        if contract.__name__.startswith("Test"):
            yield contract
        yield from contracts(contract)


EVERY = sorted(set(contracts()), key=lambda contract: (contract.__module__, contract.__name__))
CASES = [(contract, method) for contract in EVERY for method in contract.methods]
QUICK = [(contract, method) for contract, method in CASES if method in contract.compiled]


def names(value: object) -> str:
    return value.__name__ if isinstance(value, type) else str(value)


def compare(contract: type[LossContract], method: str, backend: str) -> None:
    """In one graph, and with the noise of uncompiled code, which inductor draws too if told so."""
    test = contract()
    loss = test.make_loss()
    expected = test.evaluate(loss, method)
    torch._dynamo.reset()
    with torch._inductor.config.patch(fallback_random=True):
        compiled = torch.compile(getattr(loss, method), backend=backend, fullgraph=True)
        torch.manual_seed(1)
        torch.testing.assert_close(compiled(test.make_data())[0], expected)


@pytest.mark.parametrize(("contract", "method"), QUICK, ids=names)
def test_compiled_losses_are_eager_ones(contract: type[LossContract], method: str) -> None:
    compare(contract, method, "eager")


@pytest.mark.slow
@pytest.mark.parametrize(("contract", "method"), CASES, ids=names)
def test_losses_compiled_by_inductor_are_eager_ones(contract: type[LossContract], method: str) -> None:
    compare(contract, method, "inductor")


def test_some_of_each_kind_are_compiled() -> None:
    assert len(QUICK) >= 9
