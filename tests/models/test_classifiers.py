from __future__ import annotations

import math
import time

import numpy as np
import pytest
import torch
from sklearn.linear_model import SGDClassifier

from uavrl.models import LinearClassifier, MinMaxScaler, MLPClassifier
from uavrl.models.classifiers import min_max_scale
from uavrl.models.linear_sgd import (
    decision_function,
    initial_time,
    learning_rate,
    logistic_loss,
    regularized_error,
    sgd_epoch,
)


class TestEquations:
    """Literal numbers worked out by hand."""

    def test_decision_function(self) -> None:
        """1·3 - 2·1 + 0.5 = 1.5; 0·3 + 4·(-1) + 0.5 = -3.5."""
        x = torch.tensor([[1.0, 2.0], [0.0, 4.0]])
        assert decision_function(x, torch.tensor([3.0, -1.0]), torch.tensor(0.5)).tolist() == [1.5, -3.5]

    def test_logistic_loss(self) -> None:
        """log(1 + e^{-y c}) for y = 1, -1 and c = log 3: log(4/3) and log 4."""
        logit = torch.tensor([math.log(3), math.log(3)], dtype=torch.float64)
        expected = [math.log(4 / 3), math.log(4)]
        assert logistic_loss(logit, torch.tensor([1.0, 0.0])).tolist() == pytest.approx(expected)
        assert logistic_loss(logit, torch.tensor([True, False])).tolist() == pytest.approx(expected)

    def test_regularized_error(self) -> None:
        """½ · 0.1 · (9 + 16 + 4) = 1.45."""
        weights = [torch.tensor([3.0, 4.0]), torch.tensor([[2.0]])]
        assert regularized_error(torch.tensor([0.5]), weights, 0.1).tolist() == pytest.approx([1.95])

    def test_learning_rate(self) -> None:
        """α = 1e-4: the typical weight is 10, so t_0 = 1 / (10 · 1e-4) = 1000 and the first step is 10."""
        assert initial_time(1e-4) == pytest.approx(1000)
        assert learning_rate(0, 1e-4) == pytest.approx(10)
        assert learning_rate(3000, 1e-4) == pytest.approx(2.5)

    def test_two_steps(self) -> None:
        """α = 1e-4, from zero. Sample 1: x = (1, 0), y = 1: w = (5, 0), j = 5.

        Sample 2: x = (0, 1), y = 0: c = 5, step = 10^4 / 1001; w_1 = 5 (1 - 1/1001), w_2 = -step σ(5), j = 5 + w_2.
        """
        x, y = torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([1.0, 0.0])
        weight, intercept, t = sgd_epoch(torch.zeros(2), torch.zeros(()), x, y, 0, 1e-4)
        second = -1e4 / 1001 / (1 + math.exp(-5))
        assert weight.tolist() == pytest.approx([5000 / 1001, second])
        assert float(intercept) == pytest.approx(5 + second)
        assert t == 2

    def test_min_max_scale(self) -> None:
        """The second feature is constant, the third leaves the range seen so far."""
        t = torch.tensor
        x = t([[1.0, 7.0, 3.0], [4.0, 9.0, 1.5]])
        scaled = min_max_scale(x, t([0.0, 7.0, 1.0]), t([4.0, 7.0, 2.0]))
        assert scaled.tolist() == [[0.25, 0.0, 2.0], [1.0, 0.0, 0.5]]

    @pytest.mark.parametrize(
        "call",
        [
            lambda: decision_function(torch.zeros(3, 2), torch.zeros(3), torch.zeros(())),
            lambda: logistic_loss(torch.zeros(3), torch.zeros(3, 1)),
            lambda: initial_time(0.0),
            lambda: sgd_epoch(torch.zeros(2), torch.zeros(()), torch.zeros(3, 2), torch.zeros(4), 0, 1e-4),
            lambda: sgd_epoch(torch.zeros(1), torch.zeros(()), torch.tensor([[torch.nan]]), torch.zeros(1), 0, 1e-4),
            lambda: min_max_scale(torch.zeros(3, 2), torch.zeros(3), torch.zeros(3)),
        ],
    )
    def test_bad_input_is_refused(self, call) -> None:
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

    def test_is_differentiable_in_the_features(self) -> None:
        classifier = LinearClassifier(2)
        classifier.weight.copy_(torch.tensor([2.0, -3.0]))
        x = torch.zeros(4, 5, 2, requires_grad=True)
        logit = classifier(x)
        assert logit.shape == (4, 5)
        logit.sum().backward()
        assert x.grad is not None
        assert x.grad[0, 0].tolist() == [2.0, -3.0]

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
    x = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    y = torch.tensor([0.0, 1.0, 1.0, 0.0])
    classifier = MLPClassifier(2, (16,))
    optimizer = torch.optim.Adam(classifier.parameters(), lr=0.03)
    for _ in range(200):
        optimizer.zero_grad()
        logistic_loss(classifier(x), y).mean().backward()
        optimizer.step()
    assert (classifier(x) > 0).tolist() == [False, True, True, False]


class TestMinMaxScaler:
    def test_widens_its_range(self) -> None:
        scaler = MinMaxScaler(2)
        assert scaler(torch.ones(3, 2)).tolist() == [[0.0, 0.0]] * 3
        scaler.update(torch.tensor([[1.0, 5.0]]))
        assert scaler(torch.ones(1, 2)).tolist() == [[0.0, 0.0]]
        scaler.update(torch.tensor([[3.0, 5.0], [-1.0, 5.0]]))
        assert scaler(torch.tensor([[0.0, 8.0]])).tolist() == [[0.25, 0.0]]

    def test_gradient_is_finite_before_the_first_update(self) -> None:
        x = torch.ones(1, 2, requires_grad=True)
        MinMaxScaler(2)(x).sum().backward()
        assert x.grad is not None
        assert x.grad.tolist() == [[0.0, 0.0]]
