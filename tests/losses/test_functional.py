"""Each equation on literal numbers, worked out by hand."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from uavrl.losses.functional import clamped_smooth_l1, fork_objective, fork_weight


def t(*values: object) -> Tensor:
    return torch.tensor(values)


def test_fork_objective() -> None:
    """-0.6 (1 + 0.5 · 2 + 0.25 · 4) = -1.8; -0.6 (0 + 0.5 · -2 + 0.25 · 8) = -0.6."""
    result = fork_objective(t(1.0, 0.0), t(2.0, -2.0), t(4.0, 8.0), 0.6, 0.5)
    torch.testing.assert_close(result, t(-1.8, -0.6))


@pytest.mark.parametrize(
    ("returns", "expected"),
    [
        ([], 0.6),
        ([-50.0, -10.0], 0.6),
        ([0.0, 100.0], 0.45),  # 0.6 (1 - 50 / 200)
        ([200.0], 0.0),
        ([500.0, 900.0], 0.0),
    ],
)
def test_fork_weight_falls_from_the_base_weight_to_zero(returns: list[float], expected: float) -> None:
    assert fork_weight(torch.tensor(returns), max_reward=200.0).item() == pytest.approx(expected)


def test_clamped_smooth_l1() -> None:
    """Clamped to (1, 0.5): |1 - 0| - 0.5 = 0.5 and 0.5 · 0.5² = 0.125; a clamped prediction has no gradient."""
    prediction = t([9.0, 0.5]).requires_grad_()
    loss = clamped_smooth_l1(prediction, t([0.0, 0.0]), t(-1.0, -1.0), t(1.0, 1.0))
    torch.testing.assert_close(loss, t(0.3125))
    loss.sum().backward()
    torch.testing.assert_close(prediction.grad, t([0.0, 0.25]))


@pytest.mark.parametrize(
    "call",
    [
        lambda: fork_objective(torch.zeros(5), torch.zeros(5, 1), torch.zeros(5), 0.6, 0.9),
        lambda: clamped_smooth_l1(torch.zeros(5, 2), torch.zeros(5), t(0.0), t(1.0)),
    ],
)
def test_shapes_that_would_broadcast_are_refused(call: object) -> None:
    with pytest.raises(ValueError, match="one shape"):
        call()


def test_fork_weight_refuses_what_it_cannot_divide_by() -> None:
    with pytest.raises(ValueError, match="positive max_reward"):
        fork_weight(t(1.0), 0.0)
    with pytest.raises(ValueError, match=r"returns \[E\]"):
        fork_weight(torch.zeros(2, 2), 1.0)
