"""k-means, elbow and class sizes, on data whose answer is known."""

from __future__ import annotations

import pytest
import torch

from uavrl.errors import UavrlError
from uavrl.pretraining.clustering import class_sizes, cluster, cluster_each, elbow, size_deviation, standardization


def blobs(k: int, each: int = 60, width: int = 4, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Points around k centres that lie far apart, and their blob."""
    generator = torch.Generator().manual_seed(seed)
    centres = 20 * torch.randn(k, width, generator=generator)
    labels = torch.arange(k).repeat_interleave(each)
    return centres[labels] + 0.1 * torch.randn(k * each, width, generator=generator), labels


def test_every_blob_is_one_cluster() -> None:
    points, labels = blobs(5)
    found = cluster(points, 5)
    pairs = {(a, b) for a, b in zip(labels.tolist(), found.labels.tolist(), strict=True)}
    assert len(pairs) == 5 == found.k == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    assert class_sizes(found.labels, 5).tolist() == [60] * 5


def test_the_error_is_the_sum_of_squared_distances() -> None:
    points, _ = blobs(5)
    found = cluster(points, 5)
    distances = (points - found.centres[found.labels]).double().square().sum()
    assert found.sse == pytest.approx(distances.item(), rel=1e-3)
    assert torch.equal(found.labels, torch.cdist(points, found.centres).argmin(-1))


@pytest.mark.parametrize("k", [6, 8, 10])
def test_the_elbow_of_blobs_is_their_number(k: int) -> None:
    points, _ = blobs(k)
    ks = [2, *range(4, 25, 2)]
    found = cluster_each(points, ks)
    assert list(found) == ks
    assert elbow(ks, [found[i].sse for i in ks]) == k


def test_the_elbow_of_a_curve() -> None:
    assert elbow([100, 200, 300, 400, 500, 600], [90.0, 60.0, 30.0, 28.0, 26.0, 24.0]) == 300


@pytest.mark.parametrize("sse", [[5.0, 4.0, 3.0, 2.0, 1.0], [1.0, 1.0, 1.0, 1.0, 1.0]])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_curve_without_an_elbow_is_refused(sse: list[float]) -> None:
    with pytest.raises(UavrlError, match=r"elbow in the error over k = 1 to 5 and found none: .*pretrain\.k"):
        elbow([1, 2, 3, 4, 5], sse)


def test_the_same_seed_gives_the_same_clusters() -> None:
    points = torch.randn(300, 4, generator=torch.Generator().manual_seed(0))
    one, same, other = (cluster(points, 20, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(one.centres, same.centres) and torch.equal(one.labels, same.labels) and one.sse == same.sse
    assert not torch.equal(one.centres, other.centres)


def test_standardised_features_have_mean_0_and_deviation_1() -> None:
    features = torch.tensor([[1.0, 7.0, -3.0], [3.0, 7.0, 5.0], [5.0, 7.0, 1.0]])
    mean, scale = standardization(features)
    assert mean.tolist() == [3.0, 7.0, 1.0]
    assert scale[1] == 1.0  # a feature that never changes is not blown up
    scaled = (features - mean) / scale
    assert scaled[:, 1].tolist() == [0.0, 0.0, 0.0]
    torch.testing.assert_close(scaled.std(0, correction=0), torch.tensor([1.0, 0.0, 1.0]))


def test_class_sizes_count_the_empty_classes() -> None:
    sizes = class_sizes(torch.tensor([0, 0, 3]), 5)
    assert sizes.tolist() == [2, 0, 0, 1, 0]
    assert class_sizes(torch.tensor([0, 0, 3])).tolist() == [2, 0, 0, 1]


def test_the_deviation_of_class_sizes() -> None:
    # mean 5, squares 9 + 1 + 1 + 1 + 0 + 0 + 4 + 16 = 32, 32 / 8 = 4
    assert size_deviation(torch.tensor([2, 4, 4, 4, 5, 5, 7, 9])) == 2.0
    assert size_deviation(torch.tensor([7, 7, 7])) == 0.0
