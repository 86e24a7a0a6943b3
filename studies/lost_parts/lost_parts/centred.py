"""A backward reward that does not grow: sums are compared with the class's last ones alone."""

from collections import deque
from collections.abc import Mapping
from itertools import pairwise
from math import isfinite
from operator import index

import torch
from sortedcontainers import SortedList
from torch import Tensor

from uavrl.buffers import ABR, TrajectoryHistory
from uavrl_onboard.ranges import Count, NonNegative, Share, Whole


class RecentSums(TrajectoryHistory):
    """The last sums of each class, as often as they came: what a new one is compared with does not grow for ever.

    The sums are not floored: of a reward that is the progress in metres nothing would be left.

    Args:
        window: sums that are kept of each class.

    Examples:
        >>> recent = RecentSums(window=3)
        >>> [round(recent.insert_and_rank(7, value), 2) for value in (0.5, 0.1, 0.3, 0.3)]
        [0.0, -0.5, 0.0, 0.33]
        >>> recent.values(7), recent.classes, len(recent)
        ([0.1, 0.3, 0.3], [7], 3)
    """

    dtype = torch.float64

    def __init__(self, window: int = 1000) -> None:
        super().__init__()
        self.window = window
        self._sorted: dict[int, SortedList] = {}

    def insert_and_rank(self, label: int, value: float) -> float:
        """Inserts a sum into its class and tells its place among those kept, itself included.

        Args:
            label: the class l.
            value: the sum of a window's rewards.

        Returns:
            2 F̂ - 1, with F̂ the share of smaller sums and half the share of equal ones; in (-1, 1), on average 0.

        Raises:
            ValueError: for a sum that is not finite, which nothing can be compared with.
        """
        label = index(label)
        if not isfinite(value):
            raise ValueError(f"Expected a finite sum, got {value}: check the reward.")
        came = self._values.setdefault(label, deque())
        known = self._sorted.setdefault(label, SortedList())
        came.append(value)
        known.add(value)
        if len(came) > self.window:
            known.remove(came.popleft())
        return (known.bisect_left(value) + known.bisect_right(value)) / len(known) - 1

    def load_state_dict(self, state_dict: Mapping[str, Tensor]) -> None:
        """Replaces everything by what :meth:`state_dict` gave; of more than the window the last ones are kept."""
        labels, offsets, values = (state_dict[name].tolist() for name in ("labels", "offsets", "values"))
        parts = (values[start:end][-self.window :] for start, end in pairwise(offsets))
        self._values = {label: deque(part) for label, part in zip(labels, parts, strict=True)}
        self._sorted = {label: SortedList(part) for label, part in self._values.items()}


class CentredABR(ABR):
    """ABR that pays a window's place among its class's last sums, from -1 to 1: on average nothing.

    So no flight is paid for lasting longer.

    Args:
        multiplier: the most that is paid.
        threshold, max_classes, seed, stacked, observations: as :class:`uavrl.buffers.ABR` has them.
        window: sums of a class that a new one is compared with.
    """

    def __init__(
        self, multiplier: NonNegative = 1.0, threshold: Share = 0.98, max_classes: Count = 20_000, seed: Whole = 0,
        window: Count = 1000, *, stacked: int = 3, observations: int = 105,
    ) -> None:  # fmt: skip
        super().__init__(multiplier, threshold, max_classes, seed, stacked=stacked, observations=observations)
        self.history = RecentSums(window)
