from __future__ import annotations

import pytest
import torch

from uavrl.losses.lifeguard_functional import annealed_weight, is_trusted, lifeguard_penalty
from uavrl.models.collision_classifier import confusion_counts, confusion_rates


def test_penalty_of_equation_3_11() -> None:
    assert lifeguard_penalty(torch.tensor([0.0, 0.25, 1.0]), torch.tensor(10.0)).tolist() == [0.0, 2.5, 10.0]
    with pytest.raises(ValueError, match="one weight"):
        lifeguard_penalty(torch.zeros(3), torch.zeros(3))


def test_weight_falls_with_success() -> None:
    assert annealed_weight(10.0, torch.zeros(0)) == 10.0
    assert annealed_weight(10.0, torch.tensor([1.0, 1.0, 0.0, 1.0])) == 2.5
    assert annealed_weight(10.0, torch.ones(7)) == 0.0


def test_confusion() -> None:
    predicted, actual = torch.tensor([True, True, True, False, False]), torch.tensor([True, False, False, False, True])
    counts = confusion_counts(predicted, actual)
    assert counts.tolist() == [1, 2, 1, 1]
    assert confusion_rates(counts[None]) == (0.5, 2 / 3, 1 / 3, 0.5)
    assert confusion_rates(torch.zeros(0, 4)) == (0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="bool"):
        confusion_counts(predicted.float(), actual)
    with pytest.raises(ValueError, match="one length"):
        confusion_counts(predicted[:4], actual)


@pytest.mark.parametrize(
    ("false_positives", "evaluations", "expected"),
    [(3, 20, False), (3, 21, True), (4, 21, False), (4, 1000, False), (0, 0, False)],
)
def test_trust(false_positives: int, evaluations: int, expected: bool) -> None:
    """Of 100 negatives: a rate of 0.97 is enough, 0.96 is not; 20 evaluations are not enough, 21 are."""
    counts = torch.tensor([[0, false_positives, 100 - false_positives, 100]])
    assert is_trusted(counts[: evaluations or 0], evaluations, 20, 0.96) is expected
