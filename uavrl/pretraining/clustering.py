"""k-means on features, the elbow of its error, and how evenly states fall into classes (Chansuparp (2022), §3.3, §4.2).

Features are standardised before they are clustered, each by itself to mean 0 and deviation 1: the decoder can undo any
scale of a feature, so that the scale it comes with means nothing, and k-means would listen to the largest alone.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from uavrl.errors import UavrlError
from uavrl.pretraining.networks import progress_bar


@dataclass(frozen=True)
class Clusters:
    """What k-means found.

    Attributes:
        centres: ``[k, F]`` float32.
        labels: ``[N]`` int64, the centre nearest to each feature.
        sse: Eq. 3.4, the sum of the squared distances to these centres.
    """

    centres: Tensor
    labels: Tensor
    sse: float

    @property
    def k(self) -> int:
        """The number of clusters."""
        return len(self.centres)


def standardization(features: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and deviation ``[F]`` of features ``[N, F]``; 1 in place of a deviation of 0."""
    scale = features.double().std(0, correction=0)
    scale = torch.where(scale > 1e-6, scale, 1.0)
    return features.double().mean(0).to(features.dtype), scale.to(features.dtype)


def cluster(features: Tensor, k: int, *, batch_size: int = 4096, iterations: int = 30, seed: int = 0) -> Clusters:
    """k-means by scikit-learn's ``MiniBatchKMeans``, the same for every k so that the errors compare."""
    from sklearn.cluster import MiniBatchKMeans
    from sklearn.exceptions import ConvergenceWarning

    x = np.ascontiguousarray(features.numpy(), np.float32)
    means = MiniBatchKMeans(
        k, init="k-means++", n_init=1, batch_size=batch_size, max_iter=iterations, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # fewer distinct features than clusters
        means.fit(x)
    return Clusters(torch.from_numpy(means.cluster_centers_), torch.from_numpy(means.labels_).long(), means.inertia_)


def cluster_each(features: Tensor, ks: Sequence[int], *, progress: bool = False, **options: int) -> dict[int, Clusters]:
    """:func:`cluster` for each number of clusters."""
    found = {}
    bar = progress_bar(ks, "k-means, values of k", progress)
    for k in bar:
        bar.set_postfix_str(f"k = {k}")
        found[k] = cluster(features, k, **options)
    return found


def elbow(ks: Sequence[int], sse: Sequence[float]) -> int:
    """The k at which the error stops to fall steeply, by Kneedle (Satopää et al. 2011)."""
    from kneed import KneeLocator

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of what is told below
        knee = KneeLocator(list(ks), list(sse), curve="convex", direction="decreasing").knee
    if knee is None:
        raise UavrlError(
            f"Expected an elbow in the error over k = {ks[0]} to {ks[-1]} and found none: give other values by "
            f"pretrain.clusters=[...], or the number of clusters by pretrain.k=NUMBER."
        )
    return int(knee)


def class_sizes(labels: Tensor, k: int | None = None) -> Tensor:
    """How many of the labels ``[N]`` say each class, ``[k]``."""
    return torch.bincount(labels.reshape(-1), minlength=k or 0)


def size_deviation(sizes: Tensor) -> float:
    """The standard deviation of class sizes (of all classes, not of a sample), as in Figure 4.2."""
    return sizes.double().std(correction=0).item()
