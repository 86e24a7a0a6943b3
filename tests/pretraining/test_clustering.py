"""k-means and elbow on data whose answer is known, and the pictures."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest
import torch

from uavrl.errors import UavrlError
from uavrl.pretraining import clustering
from uavrl.pretraining.clustering import cluster, cluster_each, draw, elbow, standardization


def blobs(k: int, each: int = 60, width: int = 4, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Points around k centres that lie far apart, and their blob."""
    generator = torch.Generator().manual_seed(seed)
    centres = 20 * torch.randn(k, width, generator=generator)
    labels = torch.arange(k).repeat_interleave(each)
    return centres[labels] + 0.1 * torch.randn(k * each, width, generator=generator), labels


def test_every_blob_is_one_cluster_and_the_error_the_sum_of_squared_distances() -> None:
    points, labels = blobs(5)
    found = cluster(points, 5)
    pairs = {(a, b) for a, b in zip(labels.tolist(), found.labels.tolist(), strict=True)}
    assert len(pairs) == 5 == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    assert torch.equal(found.labels, torch.cdist(points, found.centres).argmin(-1))
    distances = (points - found.centres[found.labels]).double().square().sum()
    assert found.sse == pytest.approx(distances.item(), rel=1e-3)


@pytest.mark.parametrize("k", [6, 8, 10])
def test_the_elbow_of_blobs_is_their_number(k: int) -> None:
    points, _ = blobs(k)
    ks = [2, *range(4, 25, 2)]
    found = cluster_each(points, ks)
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


SIZES = {"a": torch.tensor([3, 0, 2]), "b": torch.tensor([4, 1])}


@pytest.mark.parametrize(("ks", "files"), [([2, 3, 4], ["class_sizes.png", "elbow.png"]), ([], ["class_sizes.png"])])
def test_pictures_are_drawn_of_the_sizes_and_of_a_curve(tmp_path: Path, ks: list[int], files: list[str]) -> None:
    draw(tmp_path, ks, [9.0, 2.0, 1.0][: len(ks)], 3 if ks else None, SIZES)
    assert sorted(p.name for p in tmp_path.iterdir()) == files
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in tmp_path.iterdir())


def test_without_matplotlib_there_are_none_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(clustering.log, "disabled", False)  # Hydra disables the loggers that it finds
    with caplog.at_level(logging.INFO):
        draw(tmp_path, [2, 3], [2.0, 1.0], 2, SIZES)
    assert not list(tmp_path.iterdir())
    assert "pip install 'uavrl[viewer]'" in caplog.text
