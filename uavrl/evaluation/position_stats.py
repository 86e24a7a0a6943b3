"""Where episodes go: how high, and how near to the walls."""

from typing import Any

import numpy as np

from uavrl.envs.world import World

PERCENTILES = (5, 50, 95)
BIN = 0.25  # m of altitude


class PositionStats:
    """Collects the positions at the end of each step.

    Args:
        world: its edges, ``|x| = size[0] / 2`` and ``|y| = size[1] / 2`` of each place, are the walls that distances
            are measured to. Their slopes reach inwards from them.

    Examples:
        >>> from uavrl.envs.world import WorldConfig
        >>> places = PositionStats(World(WorldConfig()))
        >>> places.add(np.array([[0.0, 0.0, 3.5], [12.0, 0.0, 3.0]]))
        >>> places.summary()["wall_distance"]["p50"]
        11.5
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._origins = np.stack([valley.origin for valley in world.places])
        self._seen = [np.zeros((0, 3))]

    def add(self, positions: np.ndarray) -> None:
        """Takes in positions ``[M, 3]`` in m, in the world's frame."""
        self._seen.append(np.array(positions, dtype=np.float64))

    def measured(self) -> np.ndarray:
        """What :func:`summarize_places` takes, of all of them: ``[3, S]``."""
        positions = np.concatenate(self._seen)
        config = self._world.config
        nearest = np.linalg.norm(positions[:, None, :2] - self._origins, axis=-1).argmin(1)
        inside = np.abs(positions[:, :2] - self._origins[nearest])
        walls = (np.array([place.size for place in self._world.places])[nearest] / 2 - inside).min(1)
        shares = (positions[:, 2] - self._world.ground_height(positions[:, :2])) / config.ceiling
        return np.stack([positions[:, 2], shares, walls])

    def summary(self) -> dict[str, Any]:
        """:func:`summarize_places` of all of them."""
        return summarize_places(*self.measured())


def summarize_places(altitudes: np.ndarray, shares: np.ndarray, walls: np.ndarray) -> dict[str, Any]:
    """Percentiles, time in each quarter of the height, and a histogram, over S places.

    Args:
        altitudes: ``[S]`` in m, world z.
        shares: ``[S]``, height above the ground over the height of the ceiling above it.
        walls: ``[S]``, distances to the nearest wall in m; below 0 behind it, which counts as 0.

    Returns:
        ``steps``: S; ``altitude`` and ``wall_distance``: 5, 50 and 95 % percentiles in m, as ``p5``, ``p50`` and
        ``p95``; ``height_quarters``: shares of the time, lowest quarter first; ``altitude_histogram``: ``counts`` of
        steps in bins of ``step`` m from ``low`` m on.

    Examples:
        >>> found = summarize_places(np.array([1.0, 3.0]), np.array([0.2, 0.6]), np.array([5.0, 7.0]))
        >>> found["altitude"]["p50"], found["height_quarters"], found["wall_distance"]["p50"]
        (2.0, [0.5, 0.0, 0.5, 0.0], 6.0)
        >>> found["altitude_histogram"]
        {'low': 1.0, 'step': 0.25, 'counts': [1, 0, 0, 0, 0, 0, 0, 0, 1]}
    """
    if not len(altitudes):
        raise ValueError("Expected at least one step to summarise, got none.")
    quarters = np.bincount(np.clip(4 * shares, 0, 3).astype(int), minlength=4) / len(shares)
    bins = np.floor(altitudes / BIN).astype(int)
    counts = np.bincount(bins - bins.min()).tolist()
    return {
        "steps": len(altitudes),
        "altitude": _percentiles(altitudes),
        "height_quarters": quarters.tolist(),
        "wall_distance": _percentiles(np.maximum(walls, 0.0)),
        "altitude_histogram": {"low": float(bins.min() * BIN), "step": BIN, "counts": counts},
    }


def _percentiles(values: np.ndarray) -> dict[str, float]:
    return {f"p{p}": float(value) for p, value in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


def position_texts(found: dict[str, Any]) -> dict[str, str]:
    """A summary as text for a person, by its name."""
    of = {key: " / ".join(f"{found[key][f'p{p}']:.2f}" for p in PERCENTILES) for key in ("altitude", "wall_distance")}
    quarters = " / ".join(f"{100 * share:.0f}" for share in found["height_quarters"])
    percentiles = f"m ({' / '.join(f'{p}th' for p in PERCENTILES)} percentile)"
    return {
        "altitude": f"{of['altitude']} {percentiles}",
        "distance to the nearest edge of the valley": f"{of['wall_distance']} {percentiles}",
        "share of time by height": f"{quarters} % (lowest / second / third / highest quarter)",
    }
