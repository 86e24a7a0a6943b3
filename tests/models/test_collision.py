from __future__ import annotations

import math
import time

import numpy as np
import pytest
import torch
from sklearn.linear_model import SGDClassifier

from uavrl.models import CollisionClassifier, LinearClassifier, MinMaxScaler, confusion_rates
from uavrl.models.collision import learning_rate, regularized_error


def test_the_error_of_equations_3_8_and_3_9() -> None:
    """log(1 + e^{-y c}) for y = 1, -1 and c = log 3: log(4/3) and log 4; ½ · 0.1 · (9 + 16 + 4) = 1.45."""
    logit = torch.tensor([math.log(3), math.log(3)], dtype=torch.float64)
    weights = [torch.tensor([3.0, 4.0]), torch.tensor([[2.0]])]
    expected = [math.log(4 / 3) + 1.45, math.log(4) + 1.45]
    for labels in (torch.tensor([1.0, 0.0]), torch.tensor([True, False])):
        assert regularized_error(logit, labels, weights, 0.1).tolist() == pytest.approx(expected)


def test_learning_rate() -> None:
    """α = 1e-4: the typical weight is 10, so t_0 = 1 / (10 · 1e-4) = 1000 and the first step is 10."""
    assert [learning_rate(t, 1e-4) for t in (0, 3000)] == pytest.approx([10, 2.5])


def test_two_steps() -> None:
    """α = 1e-4, from zero. Sample 1: x = (1, 0), y = 1: w = (5, 0), j = 5.

    Sample 2: x = (0, 1), y = 0: c = 5, step = 10^4 / 1001; w_1 = 5 (1 - 1/1001), w_2 = -step σ(5), j = 5 + w_2.
    """
    classifier = LinearClassifier(2)
    classifier.partial_fit(torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([1.0, 0.0]))
    second = -1e4 / 1001 / (1 + math.exp(-5))
    assert classifier.weight.tolist() == pytest.approx([5000 / 1001, second])
    assert float(classifier.intercept) == pytest.approx(5 + second)
    assert int(classifier.t) == 2


@pytest.mark.parametrize(
    "call",
    [
        lambda: LinearClassifier(3)(torch.zeros(3, 2)),
        lambda: regularized_error(torch.zeros(3), torch.zeros(3, 1), [], 0.0),
        lambda: learning_rate(0, 0.0),
        lambda: LinearClassifier(2).partial_fit(torch.zeros(3, 2), torch.zeros(4)),
        lambda: LinearClassifier(1).partial_fit(torch.tensor([[torch.nan]]), torch.zeros(1)),
        lambda: MinMaxScaler(3)(torch.zeros(3, 2)),
        lambda: CollisionClassifier(2).evaluate(torch.zeros(3, 2), torch.zeros(3)),
        lambda: CollisionClassifier(2).evaluate(torch.zeros(3, 2), torch.zeros(2, dtype=torch.bool)),
    ],
)
def test_bad_input_is_refused(call) -> None:
    with pytest.raises(ValueError):
        call()


class TestLinearClassifier:
    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize("alpha", [1e-4, 1e-3, 1e-2])
    def test_agrees_with_scikit_learn(self, alpha: float, seed: int) -> None:
        """Five calls of partial_fit on the same sample order."""
        generator = np.random.default_rng(seed)
        ours = LinearClassifier(39, alpha)
        theirs = SGDClassifier(loss="log_loss", learning_rate="optimal", alpha=alpha, shuffle=False)
        for _ in range(5):
            x = generator.random((100, 39))
            y = (x[:, 0] + x[:, 1] * 0.5 + 0.2 * generator.standard_normal(100) > 0.75).astype(np.float64)
            theirs.partial_fit(x, y, classes=[0.0, 1.0])
            ours.partial_fit(torch.from_numpy(x), torch.from_numpy(y))
            np.testing.assert_allclose(ours.weight.numpy(), theirs.coef_[0], rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(float(ours.intercept), theirs.intercept_[0], rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(
                ours(torch.from_numpy(x)).numpy(), theirs.decision_function(x), rtol=1e-9, atol=1e-9
            )

    def test_extreme_logits(self) -> None:
        classifier = LinearClassifier(1)
        classifier.weight.fill_(1e6)
        classifier.partial_fit(torch.tensor([[1.0], [-1.0]]), torch.tensor([0.0, 1.0]))
        assert classifier.weight.isfinite().all()

    def test_logits_of_equation_3_7_and_their_gradient(self) -> None:
        """1·2 - 2·3 + 0.5 = -3.5; 0·2 - 4·3 + 0.5 = -11.5."""
        classifier = LinearClassifier(2)
        classifier.weight.copy_(torch.tensor([2.0, -3.0]))
        classifier.intercept.fill_(0.5)
        x = torch.tensor([[[1.0, 2.0], [0.0, 4.0]]], requires_grad=True)
        logit = classifier(x)
        assert logit.tolist() == [[-3.5, -11.5]]
        (gradient,) = torch.autograd.grad(logit.sum(), x)
        assert gradient.tolist() == [[[2.0, -3.0]] * 2]

    def test_continues_from_its_state(self) -> None:
        torch.manual_seed(0)
        x, y = torch.rand(20, 3), torch.rand(20) > 0.5
        one, other = LinearClassifier(3), LinearClassifier(3)
        one.partial_fit(x, y)
        other.load_state_dict(one.state_dict())
        one.partial_fit(x, y)
        other.partial_fit(x, y)
        assert torch.equal(one.weight, other.weight)
        assert int(one.t) == 40

    @pytest.mark.slow
    def test_is_fast(self) -> None:
        """100 samples of 39 features in less than a millisecond."""
        classifier = LinearClassifier(39)
        x, y = torch.rand(100, 39), torch.rand(100) > 0.5
        times: list[float] = []
        for _ in range(50):
            start = time.perf_counter()
            classifier.partial_fit(x, y)
            times.append(time.perf_counter() - start)
        assert min(times) < 1e-3


def test_mlp_learns_what_a_linear_one_cannot() -> None:
    """Exclusive or."""
    torch.manual_seed(0)
    x, y = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]), torch.tensor([False, True, True, False])
    classifier = CollisionClassifier(2, "mlp")
    classifier.scaler.update(x)
    classifier.fit(x.expand(200, -1, -1), y.expand(200, -1), torch.optim.Adam(classifier.parameters(), lr=0.03))
    assert torch.equal(classifier(x) > 0, y)


def test_a_scaler_widens_its_range() -> None:
    """The second feature is constant; a value beyond the range is not clamped; before the first update all are 0."""
    scaler, x = MinMaxScaler(2), torch.ones(1, 2, requires_grad=True)
    (gradient,) = torch.autograd.grad(scaler(x).sum(), x)
    assert scaler(x).tolist() == gradient.tolist() == [[0.0, 0.0]]
    scaler.update(torch.tensor([[1.0, 5.0]]))
    assert scaler(torch.ones(3, 2)).tolist() == [[0.0, 0.0]] * 3
    scaler.update(torch.tensor([[3.0, 5.0], [-1.0, 5.0]]))
    assert scaler(torch.tensor([[0.0, 8.0], [5.0, 5.0]])).tolist() == [[0.25, 0.0], [1.5, 0.0]]


def test_confusion() -> None:
    classifier = CollisionClassifier(1, torch.nn.Flatten(0))
    classifier.scaler.update(torch.tensor([[0.0], [1.0]]))  # features are their own logits
    features = torch.tensor([[1.0], [1.0], [1.0], [-1.0], [-1.0]])
    counts = classifier.evaluate(features, torch.tensor([True, False, False, False, True]))
    assert counts.tolist() == [1, 2, 1, 1]
    assert confusion_rates(counts[None]) == (0.5, 2 / 3, 1 / 3, 0.5)
    assert confusion_rates(torch.zeros(0, 4)) == (0.0, 0.0, 0.0, 0.0)
