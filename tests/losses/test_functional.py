"""Each equation on literal numbers, worked out by hand."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from uavrl.losses.functional import (
    bipedal_fork_objective,
    clamped_smooth_l1,
    fork_objective,
    fork_weight,
    masked_mse,
)


def t(*values: object) -> Tensor:
    return torch.tensor(values)


def test_fork_objective() -> None:
    """-0.6 (1 + 0.5 · 2 + 0.25 · 4) = -1.8; -0.6 (0 + 0.5 · -2 + 0.25 · 8) = -0.6."""
    result = fork_objective(t(1.0, 0.0), t(2.0, -2.0), t(4.0, 8.0), 0.6, 0.5)
    torch.testing.assert_close(result, t(-1.8, -0.6))


def test_bipedal_fork_objective() -> None:
    """-0.8 · 2 - 0.4 · 5 = -3.6."""
    torch.testing.assert_close(bipedal_fork_objective(t(2.0), t(5.0), 0.8), t(-3.6))


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


def test_fork_weight_of_the_bipedal_variant() -> None:
    assert fork_weight(t(75.0), 300.0, base_weight=1.0).item() == pytest.approx(0.75)


def test_clamped_smooth_l1() -> None:
    """Clamped to (1, 0.5): |1 - 0| - 0.5 = 0.5 and 0.5 · 0.5² = 0.125; a clamped prediction has no gradient."""
    prediction = t([9.0, 0.5]).requires_grad_()
    loss = clamped_smooth_l1(prediction, t([0.0, 0.0]), t(-1.0, -1.0), t(1.0, 1.0))
    torch.testing.assert_close(loss, t(0.3125))
    loss.sum().backward()
    torch.testing.assert_close(prediction.grad, t([0.0, 0.25]))


def test_masked_mse_leaves_out_last_steps() -> None:
    prediction = t([1.0, 3.0], [float("nan"), 2.0])
    torch.testing.assert_close(masked_mse(prediction, torch.zeros(2, 2), t(False, True)), t(5.0, 0.0))


@pytest.mark.parametrize(
    "call",
    [
        lambda: fork_objective(torch.zeros(5), torch.zeros(5, 1), torch.zeros(5), 0.6, 0.9),
        lambda: bipedal_fork_objective(torch.zeros(5), torch.zeros(5, 1), 0.6),
        lambda: clamped_smooth_l1(torch.zeros(5, 2), torch.zeros(5), t(0.0), t(1.0)),
        lambda: masked_mse(torch.zeros(5, 2), torch.zeros(5, 2), torch.zeros(5, 1, dtype=torch.bool)),
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
