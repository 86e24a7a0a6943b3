"""Adam without PyTorch's bookkeeping is PyTorch's Adam."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn

from uavrl.training.adam import DirectAdam


def parameters() -> list[nn.Parameter]:
    generator = torch.Generator().manual_seed(0)
    return [nn.Parameter(torch.randn(size, generator=generator)) for size in ((4, 3), (4,), (1, 4))]


def gradients(turn: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(turn)
    return [torch.randn(p.shape, generator=generator) for p in parameters()]


def descend(optimizer: torch.optim.Adam, turns: range) -> None:
    for turn in turns:
        if isinstance(optimizer, DirectAdam):
            optimizer.descend(gradients(turn))
            continue
        for parameter, gradient in zip(optimizer.param_groups[0]["params"], gradients(turn), strict=True):
            parameter.grad = gradient
        optimizer.step()


def test_its_steps_are_those_of_pytorchs_fused_adam() -> None:
    ours, theirs = parameters(), parameters()
    descend(DirectAdam(ours, lr=0.01), range(20))
    descend(torch.optim.Adam(theirs, lr=0.01, fused=True), range(20))
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.mark.parametrize("first", [DirectAdam, torch.optim.Adam])
@pytest.mark.parametrize("second", [DirectAdam, torch.optim.Adam])
def test_either_goes_on_where_the_other_stopped(first: type, second: type) -> None:
    straight, changed = parameters(), parameters()
    descend(torch.optim.Adam(straight, lr=0.01, fused=True), range(20))
    before = first(changed, lr=0.01, **({} if first is DirectAdam else {"fused": True}))
    descend(before, range(9))
    after = second(changed, lr=0.01, **({} if second is DirectAdam else {"fused": True}))
    after.load_state_dict(copy.deepcopy(before.state_dict()))
    descend(after, range(9, 20))
    assert all(torch.equal(a, b) for a, b in zip(straight, changed, strict=True))
    assert [state["step"].item() for state in after.state_dict()["state"].values()] == [20.0] * 3


def test_a_step_without_gradients_is_refused() -> None:
    with pytest.raises(TypeError, match=r"call descend\(gradients\)"):
        DirectAdam(parameters(), lr=0.01).step()
