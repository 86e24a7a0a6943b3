"""k-means on features, the elbow of its error, and pictures of both (Chansuparp (2022), §3.3, §4.2).

Features are standardised before they are clustered, each by itself to mean 0 and deviation 1: the decoder can undo any
scale of a feature, so that the scale it comes with means nothing, and k-means would follow the largest alone.
"""

import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from uavrl.errors import UavrlError, extras
from uavrl.runs.progress_line import ProgressLine

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Clusters:
    """A result of k-means.

    Attributes:
        centres: ``[k, F]`` float32.
        labels: ``[N]`` int64, the centre nearest to each feature.
        sse: Eq. 3.4, the sum of the squared distances to these centres.
    """

    centres: Tensor
    labels: Tensor
    sse: float


def standardization(features: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and deviation ``[F]`` of features ``[N, F]``; 1 in place of a deviation of 0."""
    scale = features.double().std(0, correction=0)
    scale = torch.where(scale > 1e-6, scale, 1.0)
    return features.double().mean(0).to(features.dtype), scale.to(features.dtype)


def cluster(features: Tensor, k: int, *, batch_size: int = 4096, iterations: int = 30, seed: int = 0) -> Clusters:
    """k-means by scikit-learn's ``MiniBatchKMeans``, the same for every k so that the errors compare."""
    with extras():
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
    with ProgressLine(len(ks), "values of k", enabled=progress) as line:
        for k in ks:
            line.add(0, f"k = {k}")
            found[k] = cluster(features, k, **options)
            line.add()
    return found


def elbow(ks: Sequence[int], sse: Sequence[float]) -> int:
    """The k at which the error stops to fall steeply, by Kneedle (Satopää et al. 2011)."""
    with extras():
        from kneed import KneeLocator

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error below says the same
        knee = KneeLocator(list(ks), list(sse), curve="convex", direction="decreasing").knee
    if knee is None:
        raise UavrlError(
            f"Expected an elbow in the error over k = {ks[0]} to {ks[-1]} and found none: give other values by "
            f"pretrain.clusters=[...], or the number of clusters by pretrain.k=NUMBER."
        )
    return int(knee)


def draw(output: Path, ks: Sequence[int], sse: Sequence[float], elbow: int | None, sizes: Mapping[str, Tensor]) -> None:
    """Draws the SSE curve with its elbow and the class sizes (Figure 4.2), or logs that matplotlib is missing.

    The files are ``elbow.png``, where there is a curve, and ``class_sizes.png``.
    """
    try:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
    except ImportError:
        log.info("Pictures are left out, they need matplotlib: pip install 'uavrl[viewer]'.")
        return
    if ks:
        figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
        axis.plot(ks, sse, marker="o", markersize=3)
        if elbow is not None:
            axis.axvline(elbow, color="black", linestyle="--", linewidth=1, label=f"elbow at k = {elbow}")
            axis.legend()
        axis.set(xlabel="number of clusters k", ylabel="sum of squared distances (SSE)", ylim=(0, None))
        axis.grid(alpha=0.3)
        figure.savefig(output / "elbow.png", dpi=110)
        plt.close(figure)
    figure, axes = plt.subplots(1, len(sizes), figsize=(5 * len(sizes), 4), squeeze=False, layout="constrained")
    for axis, (title, size) in zip(axes[0], sizes.items(), strict=True):
        axis.fill_between(range(len(size)), size.sort(descending=True).values.tolist(), step="mid")
        axis.set(xlabel="class, largest first", ylabel="states", ylim=(0, None))
        axis.set_title(f"{title}\n{len(size)} classes, SD {size.double().std(correction=0):.2f}", fontsize=10)
    figure.savefig(output / "class_sizes.png", dpi=110)
    plt.close(figure)
