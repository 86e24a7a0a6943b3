"""What a LiDAR gets wrong or does not see, in its ranges."""

import math
from collections.abc import Sequence

import numpy as np


def add_noise(ranges: np.ndarray, noise: Sequence[float], dropout: Sequence[float], rng: np.random.Generator) -> None:
    """Applies to ``ranges [N, R]`` in m, NaN where there is none, what each of the N sensors has.

    Args:
        ranges: changed in place; none falls below 0.
        noise: standard deviations of the range error in m.
        dropout: probabilities that a return is lost.
        rng: source of both.

    Examples:
        >>> ranges = np.full((2, 10000), 5.0, dtype=np.float32)
        >>> add_noise(ranges, [0.0, 0.1], [0.5, 0.0], np.random.default_rng(0))
        >>> np.isnan(ranges).mean(1).round(1).tolist(), np.nanstd(ranges, axis=1, dtype=float).round(2).tolist()
        ([0.5, 0.0], [0.0, 0.1])
    """
    if not (any(noise) or any(dropout)):
        return
    hit = ~np.isnan(ranges)
    measured, counts = ranges[hit], hit.sum(axis=1)
    if any(noise):
        error = np.repeat(np.array(noise, dtype=np.float32), counts) * rng.standard_normal(
            len(measured), dtype=np.float32
        )
        measured = np.maximum(measured + error, 0.0)
    if any(dropout):
        measured[rng.random(len(measured)) < np.repeat(dropout, counts)] = np.nan
    ranges[hit] = measured


def hide_sector(ranges: np.ndarray, azimuths: np.ndarray, azimuth: float, width: float) -> None:
    """Takes the returns from a sector of ``ranges [R]``, around an azimuth (left positive) and of a width in rad.

    ``azimuths [C]`` are those of C groups of rays, in rad clockwise from straight ahead.
    """
    begin = (-azimuth - width / 2) % math.tau
    ranges.reshape(len(azimuths), -1)[(azimuths - begin) % math.tau <= width] = np.nan
