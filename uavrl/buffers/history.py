"""The history of the backward reward: all distinct sums seen in each class of trajectories."""

from collections.abc import Mapping
from itertools import pairwise
from math import floor
from operator import index
from typing import Any, ClassVar

import torch
from sortedcontainers import SortedList
from torch import Tensor


class TrajectoryHistory:
    """The trajectories' history H of Chansuparp (2022), §3.4: class → its distinct integers, sorted.

    An insertion takes about the logarithm of the number of values in the class, which has no bound: a class holds as
    many values as there are different floored sums, a few hundred at most for the rewards of navigation.

    Examples:
        >>> history = TrajectoryHistory()
        >>> [history.insert_and_rank(7, value) for value in (12, 4, 9, 4)]
        [0, 0, 1, 0]
        >>> history.values(7), history.classes, len(history)
        ([4, 9, 12], [7], 3)
    """

    dtype: ClassVar[torch.dtype] = torch.int64  # type of the values in a checkpoint

    def __init__(self) -> None:
        self._values: dict[int, Any] = {}

    def __len__(self) -> int:
        """The number of stored values, in all classes together."""
        return sum(map(len, self._values.values()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}(classes={len(self._values)}, values={len(self)})"

    @property
    def classes(self) -> list[int]:
        """The classes seen, in ascending order."""
        return sorted(self._values)

    def state_dict(self) -> dict[str, Tensor]:
        """The history as three flat tensors.

        Returns:
            ``labels [C]`` in ascending order, ``offsets [C + 1]``, and ``values [M]``: those of class ``labels[c]`` are
            ``values[offsets[c] : offsets[c + 1]]``.
        """
        sizes = [0, *(len(self._values[label]) for label in self.classes)]
        values = [value for label in self.classes for value in self._values[label]]
        return {
            "labels": torch.tensor(self.classes, dtype=torch.int64),
            "offsets": torch.tensor(sizes, dtype=torch.int64).cumsum(0),
            "values": torch.tensor(values, dtype=self.dtype),
        }

    def values(self, label: int) -> list[int]:
        """The distinct values of a class in ascending order; an empty list for a class not seen."""
        return list(self._values.get(label, ()))

    def insert_and_rank(self, label: int, value: float) -> float:
        """Inserts a value into its class, unless it is there, and returns its rank (Algorithm 3.1, "return m").

        Args:
            label: the class l.
            value: the sum R, which is floored.

        Returns:
            m, the number of smaller values in the class.

        Raises:
            TypeError: when the label is no integer, or the value no number.
        """
        label, value = index(label), floor(value)
        known = self._values.setdefault(label, SortedList())
        rank = known.bisect_left(value)
        if rank == len(known) or known[rank] != value:
            known.add(value)
        return rank

    def load_state_dict(self, state_dict: Mapping[str, Tensor]) -> None:
        """Restores what :meth:`state_dict` returned.

        Raises:
            ValueError: when the tensors do not fit together.
        """
        labels, offsets, values = (state_dict[name].tolist() for name in ("labels", "offsets", "values"))
        parts = [values[start:end] for start, end in pairwise(offsets)]
        whole = offsets[:1] == [0] and offsets[-1:] == [len(values)] and offsets == sorted(offsets)
        ascending = all(a < b for part in parts for a, b in pairwise(part))
        if not (whole and ascending and len(parts) == len(labels) == len(set(labels))):
            raise ValueError(
                f"Expected {len(labels)} classes, each with ascending values, got {len(values)} values and "
                f"{len(offsets)} offsets that do not fit: the state is damaged, take an older checkpoint."
            )
        self._values = {label: SortedList(part) for label, part in zip(labels, parts, strict=True)}
