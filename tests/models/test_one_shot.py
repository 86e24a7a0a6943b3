from __future__ import annotations

import copy

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from uavrl.models import OneShotClassifier
from uavrl.models.one_shot import convolve_frames, join_or_found


def random_states(count: int, seed: int = 0, width: int = 35, frames: int = 3) -> Tensor:
    return torch.randn(count, width * frames, generator=torch.Generator().manual_seed(seed))


def one_by_one(features: Tensor, exemplars: Tensor, threshold: float, limit: int) -> tuple[list[int], list[Tensor]]:
    """The rule as the thesis tells it, a state at a time."""
    labels, known = [], list(exemplars)
    for row in features:
        similarities = [float(row @ exemplar) for exemplar in known]
        best = max(range(len(known)), key=similarities.__getitem__, default=None)
        if best is not None and (similarities[best] >= threshold or len(known) >= limit):
            labels.append(best)
        else:
            labels.append(len(known))
            known.append(row)
    return labels, known


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(0, 30), st.integers(0, 6), st.sampled_from([-0.5, 0.5, 0.9]), st.integers(1, 40)
)
def test_a_batch_is_as_good_as_a_state_at_a_time(
    seed: int, count: int, known: int, threshold: float, limit: int
) -> None:
    generator = torch.Generator().manual_seed(seed)
    features, exemplars = (
        F.normalize(torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=-1) for n in (count, known)
    )
    labels, found = join_or_found(features, exemplars, threshold, limit)
    expected_labels, expected = one_by_one(features, exemplars, threshold, limit)
    assert labels.tolist() == expected_labels
    assert found.tolist() == [row.tolist() for row in expected]


def test_joining_and_founding_by_hand() -> None:
    """Similarity 0.6 to the first and 0.8 to the second founder: joins the second, though it came later."""
    features = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8], [0.8, 0.6], [-1.0, 0.0]])
    labels, exemplars = join_or_found(features, torch.empty(0, 2), 0.5, 100)
    assert labels.tolist() == [0, 1, 1, 0, 2]
    assert exemplars.tolist() == [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]
    labels, exemplars = join_or_found(features, torch.empty(0, 2), 0.5, 2)
    assert labels.tolist() == [0, 1, 1, 0, 1]
    assert len(exemplars) == 2


def test_the_convolution_is_torchs_over_time() -> None:
    """Two frames of two numbers seen at once: three frames give two places."""
    layer = nn.Conv1d(2, 5, 2)
    states = torch.randn(4, 6)
    frames = torch.stack([states[:, 0:2], states[:, 2:4], states[:, 4:6]], dim=-1)
    expected = F.normalize(layer(frames).relu().flatten(1), dim=-1)
    torch.testing.assert_close(convolve_frames(states, layer.weight, layer.bias), expected)


def test_states_without_features_are_alike() -> None:
    features = convolve_frames(-torch.ones(2, 3), torch.ones(4, 1, 3), torch.zeros(4))
    assert features.tolist() == [[0.5] * 4] * 2
    assert join_or_found(features, torch.empty(0, 4), 0.98, 10)[0].tolist() == [0, 0]


def test_states_of_the_thesis_have_twenty_features_and_nearly_the_same_ones_join() -> None:
    classifier, states = OneShotClassifier(), random_states(30)
    labels = classifier(states)
    assert (labels.dtype, labels.shape, classifier.exemplars.shape[1]) == (torch.int64, (30,), 20)
    assert torch.equal(classifier(states + 1e-3 * random_states(30, seed=1)), labels)
    assert len(classifier) == int(labels.max()) + 1 > 20
    assert not list(classifier.parameters())
    assert classifier(torch.empty(0, 105)).tolist() == []


def test_memory_is_bounded_and_chunks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (OneShotClassifier(threshold=0.8, max_classes=10) for _ in range(2))
    states = random_states(500)
    expected = one(states)
    assert int(expected.max()) + 1 == len(one) == 10
    monkeypatch.setattr(OneShotClassifier, "CHUNK", 7)
    assert torch.equal(other(states), expected)
    assert torch.equal(other.exemplars, one.exemplars)


def test_the_seed_draws_the_convolution_and_nothing_else_does() -> None:
    torch.manual_seed(3)
    state = torch.get_rng_state()
    one, same, other = OneShotClassifier(), OneShotClassifier(), OneShotClassifier(seed=1)
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(one.weight, same.weight)
    assert not torch.equal(one.weight, other.weight)


def test_state_round_trip() -> None:
    one, other = OneShotClassifier(), OneShotClassifier(seed=1)
    one(random_states(40))
    other(random_states(3, seed=8))
    other.load_state_dict(one.state_dict())
    assert torch.equal(other(random_states(60, seed=1)), one(random_states(60, seed=1)))
    nested, empty = nn.Sequential(OneShotClassifier()), nn.Sequential(OneShotClassifier())
    nested.load_state_dict(nn.Sequential(one).state_dict())
    assert len(nested[0]) == len(one)
    nested.load_state_dict(empty.state_dict())
    assert len(nested[0]) == 0
    with pytest.raises(RuntimeError, match="exemplars"):
        OneShotClassifier(features=10).load_state_dict(one.state_dict())
    assert len(copy.deepcopy(one)) == len(one)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: OneShotClassifier(features=21), "features that divide"),
        (lambda: OneShotClassifier(kernel=4), "at most 3 frames"),
        (lambda: OneShotClassifier(max_classes=0), "max_classes=0"),
        (lambda: OneShotClassifier(threshold=98), "threshold, got 98"),
        (lambda: OneShotClassifier()(torch.zeros(2, 70)), r"\[N, 3 \* 35\], got \[2, 70\]"),
        (lambda: OneShotClassifier()(torch.zeros(105)), r"got \[105\]"),
        (lambda: OneShotClassifier()(torch.full((1, 105), torch.nan)), "finite states"),
        (lambda: convolve_frames(torch.zeros(2, 7), torch.zeros(4, 3, 2), torch.zeros(4)), r"got \[2, 7\]"),
    ],
)
def test_what_does_not_fit_is_refused(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
