"""The reductions in numpy beside those in PyTorch, on random clouds."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from uavrl.transforms import REDUCTIONS
from uavrl_onboard.perception.reductions import range_image, truncated_icosahedron

PAIRS = [(truncated_icosahedron, "truncated_icosahedron"), (range_image, "range_image")]
MISSES = ([np.nan] * 3, [np.inf, 0, 0], [0.0, -np.inf, np.nan], [0.0, 0.0, 0.0], [0.03, 0.03, 0.0])


def clouds(number: int, points: int, seed: int = 0) -> np.ndarray:
    """Random clouds ``float32 [number, points, 3]`` up to 6 m away, a fifth of them misses of all kinds."""
    rng = np.random.default_rng(seed)
    towards = rng.normal(size=(number, points, 3))
    drawn = towards / np.linalg.norm(towards, axis=-1, keepdims=True) * rng.uniform(0.02, 6, (number, points, 1))
    missed = rng.random((number, points)) < 0.2
    drawn[missed] = np.array(MISSES)[rng.integers(len(MISSES), size=missed.sum())]
    return drawn.astype(np.float32)


def check_clouds(ours: Any, name: Any, statistic: str, number: int) -> None:
    """Compares both on some random clouds, to 1e-6 m."""
    drawn = clouds(number, 20)
    theirs = REDUCTIONS[name].reduced(torch.from_numpy(drawn), 4.0, statistic).numpy()
    found = np.stack([ours(cloud, 4.0, statistic) for cloud in drawn])
    assert found.dtype == np.float32 and found.shape == theirs.shape
    np.testing.assert_allclose(found, theirs, rtol=0, atol=1e-6)
    assert 0.05 < (theirs == 0).mean() < 0.95
