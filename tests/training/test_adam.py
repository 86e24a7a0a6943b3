"""Adam without PyTorch's bookkeeping is PyTorch's Adam."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn

from uavrl.errors import UavrlError
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


def test_gradients_of_other_strides_move_the_right_entries() -> None:
    ours, theirs = parameters(), parameters()
    optimizers = DirectAdam(ours, lr=0.01), torch.optim.Adam(theirs, lr=0.01, foreach=False)
    for turn in range(20):
        expected = gradients(turn)
        transposed = [g.t().contiguous().t() if g.ndim == 2 else g for g in expected]
        assert transposed[0].stride() == (1, 4)
        optimizers[0].descend(transposed)
        for parameter, gradient in zip(theirs, expected, strict=True):
            parameter.grad = gradient
        optimizers[1].step()
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)


def test_a_transposed_parameter_goes_on_from_what_was_saved_contiguous() -> None:
    """One that lies column by column, with averages that a checkpoint gave back row by row."""
    values = [torch.randn(4, 3, generator=torch.Generator().manual_seed(turn)) for turn in range(21)]
    straight, transposed = nn.Parameter(values[20].clone()), nn.Parameter(values[20].t().contiguous().t())
    reference, first = DirectAdam([straight], lr=0.01), DirectAdam([transposed], lr=0.01)
    for gradient in values[:10]:
        reference.descend([gradient])
        first.descend([gradient])
    saved = first.state_dict()
    for name in ("exp_avg", "exp_avg_sq"):
        saved["state"][0][name] = saved["state"][0][name].contiguous()
    second = DirectAdam([transposed], lr=0.01)
    second.load_state_dict(saved)
    for gradient in values[10:20]:
        reference.descend([gradient])
        second.descend([gradient])
    torch.testing.assert_close(transposed, straight, rtol=1e-6, atol=1e-6)


def test_a_parameter_that_shares_memory_is_refused() -> None:
    with pytest.raises(UavrlError, match=r"shape \(2, 3\) with strides \(0, 1\): give each network weights of its own"):
        DirectAdam([torch.zeros(3).expand(2, 3)], lr=0.01)


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
