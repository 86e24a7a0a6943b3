"""The SSE curve with its elbow, and the class sizes side by side (Chansuparp (2022), Figure 4.2)."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from uavrl.pretraining.clustering import size_deviation

log = logging.getLogger(__name__)


def draw(output: Path, ks: Sequence[int], sse: Sequence[float], elbow: int | None, sizes: Mapping[str, Tensor]) -> None:
    """Draws ``elbow.png`` and ``class_sizes.png`` into a folder; says so where matplotlib is not installed."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
    except ImportError:
        log.info("Pictures are left out, they need matplotlib: pip install 'uavrl[viewer]'.")
        return
    if ks:
        _save(_elbow(plt, ks, sse, elbow), output / "elbow.png", plt)
    _save(_class_sizes(plt, sizes), output / "class_sizes.png", plt)


def _elbow(plt: Any, ks: Sequence[int], sse: Sequence[float], elbow: int | None) -> Any:
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    axis.plot(ks, sse, marker="o", markersize=3)
    if elbow is not None:
        axis.axvline(elbow, color="black", linestyle="--", linewidth=1, label=f"elbow at k = {elbow}")
        axis.legend()
    axis.set(xlabel="number of clusters k", ylabel="sum of squared distances (SSE)", ylim=(0, None))
    axis.grid(alpha=0.3)
    return figure


def _class_sizes(plt: Any, sizes: Mapping[str, Tensor]) -> Any:
    figure, axes = plt.subplots(1, len(sizes), figsize=(5 * len(sizes), 4), squeeze=False, layout="constrained")
    for axis, (title, size) in zip(axes[0], sizes.items(), strict=True):
        axis.fill_between(range(len(size)), size.sort(descending=True).values.tolist(), step="mid")
        axis.set(xlabel="class, largest first", ylabel="states", ylim=(0, None))
        axis.set_title(f"{title}\n{len(size)} classes, SD {size_deviation(size):.2f}", fontsize=10)
    return figure


def _save(figure: Any, path: Path, plt: Any) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)
