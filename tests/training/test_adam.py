"""Adam without PyTorch's bookkeeping is PyTorch's Adam."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.training.compiled import FusedAdam


def parameters() -> list[nn.Parameter]:
    generator = torch.Generator().manual_seed(0)
    return [nn.Parameter(torch.randn(size, generator=generator)) for size in ((4, 3), (4,), (1, 4))]


def gradients(turn: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(turn)
    return [torch.randn(p.shape, generator=generator) for p in parameters()]


def descend(optimizer: torch.optim.Adam, turns: range) -> None:
    for turn in turns:
        if isinstance(optimizer, FusedAdam):
            optimizer.apply(gradients(turn))
            continue
        for parameter, gradient in zip(optimizer.param_groups[0]["params"], gradients(turn), strict=True):
            parameter.grad = gradient
        optimizer.step()


def test_its_steps_are_those_of_pytorchs_fused_adam() -> None:
    ours, theirs = parameters(), parameters()
    descend(FusedAdam(ours, lr=0.01), range(20))
    descend(torch.optim.Adam(theirs, lr=0.01, fused=True), range(20))
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_gradients_of_other_strides_move_the_right_entries() -> None:
    ours, theirs = parameters(), parameters()
    optimizers = FusedAdam(ours, lr=0.01), torch.optim.Adam(theirs, lr=0.01, foreach=False)
    for turn in range(20):
        expected = gradients(turn)
        transposed = [g.t().contiguous().t() if g.ndim == 2 else g for g in expected]
        assert transposed[0].stride() == (1, 4)
        optimizers[0].apply(transposed)
        for parameter, gradient in zip(theirs, expected, strict=True):
            parameter.grad = gradient
        optimizers[1].step()
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)


def test_a_transposed_parameter_goes_on_from_what_was_saved_contiguous() -> None:
    """One that lies column by column, with averages that a checkpoint gave back row by row."""
    values = [torch.randn(4, 3, generator=torch.Generator().manual_seed(turn)) for turn in range(21)]
    straight, transposed = nn.Parameter(values[20].clone()), nn.Parameter(values[20].t().contiguous().t())
    reference, first = FusedAdam([straight], lr=0.01), FusedAdam([transposed], lr=0.01)
    for gradient in values[:10]:
        reference.apply([gradient])
        first.apply([gradient])
    saved = first.state_dict()
    for name in ("exp_avg", "exp_avg_sq"):
        saved["state"][0][name] = saved["state"][0][name].contiguous()
    second = FusedAdam([transposed], lr=0.01)
    second.load_state_dict(saved)
    for gradient in values[10:20]:
        reference.apply([gradient])
        second.apply([gradient])
    torch.testing.assert_close(transposed, straight, rtol=1e-6, atol=1e-6)


def test_a_parameter_that_shares_memory_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"shape \(2, 3\) with strides \(0, 1\)"):
        FusedAdam([torch.zeros(3).expand(2, 3)], lr=0.01)


@pytest.mark.parametrize("first", [FusedAdam, torch.optim.Adam])
@pytest.mark.parametrize("second", [FusedAdam, torch.optim.Adam])
def test_either_goes_on_where_the_other_stopped(first: type, second: type) -> None:
    straight, changed = parameters(), parameters()
    descend(torch.optim.Adam(straight, lr=0.01, fused=True), range(20))
    before = first(changed, lr=0.01, **({} if first is FusedAdam else {"fused": True}))
    descend(before, range(9))
    after = second(changed, lr=0.01, **({} if second is FusedAdam else {"fused": True}))
    after.load_state_dict(copy.deepcopy(before.state_dict()))
    descend(after, range(9, 20))
    assert all(torch.equal(a, b) for a, b in zip(straight, changed, strict=True))
    assert [state["step"].item() for state in after.state_dict()["state"].values()] == [20.0] * 3
