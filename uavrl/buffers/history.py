"""What the backward reward remembers of each class of trajectories: all distinct sums seen."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import floor
from operator import index
from typing import Any, ClassVar

import torch
from sortedcontainers import SortedList
from torch import Tensor


class TrajectoryHistory:
    """The trajectories' history H of Chansuparp (2022), §3.4: class → its distinct integers, sorted.

    An insertion takes about the logarithm of the number of values in the class. There is no bound: a class holds
    as many values as there are different floored sums, a few hundred at most for the rewards of navigation.

    Examples:
        >>> history = TrajectoryHistory()
        >>> [history.insert_and_rank(7, value) for value in (12, 4, 9, 4)]
        [0, 0, 1, 0]
        >>> history.values(7), history.classes, len(history)
        ([4, 9, 12], [7], 3)
    """

    dtype: ClassVar[torch.dtype] = torch.int64  # of the values in a checkpoint

    def __init__(self) -> None:
        self._values: dict[int, Any] = {}

    def __len__(self) -> int:
        """How many values are stored, in all classes together."""
        return sum(map(len, self._values.values()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}(classes={len(self._values)}, values={len(self)})"

    @property
    def classes(self) -> list[int]:
        """The classes seen, in ascending order."""
        return sorted(self._values)

    def state_dict(self) -> dict[str, Tensor]:
        """Everything as three flat tensors.

        Returns:
            ``labels [C]`` int64 in ascending order, ``values [M]`` class after class, in the order of
            ``values(label)``, and ``offsets [C + 1]`` int64: the values of class ``labels[c]`` are
            ``values[offsets[c] : offsets[c + 1]]``.
        """
        return _flat({label: self._values[label] for label in self.classes}, self.dtype)

    def values(self, label: int) -> list[int]:
        """The distinct values of a class in ascending order; none for a class not seen."""
        return list(self._values.get(label, ()))

    def insert_and_rank(self, label: int, value: float) -> float:
        """Inserts a value into its class, unless it is there, and tells its place (Algorithm 3.1, "return m").

        Args:
            label: the class l.
            value: the sum R, which is floored.

        Returns:
            m: how many values of the class are smaller.

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
        """Replaces everything by what :meth:`state_dict` gave.

        Raises:
            ValueError: when the tensors do not fit together.
        """
        parts = _parts(state_dict)
        if not all(a < b for values in parts.values() for a, b in pairwise(values)):
            raise ValueError(
                f"Expected {len(parts)} classes whose values ascend: the state is damaged, take an older one."
            )
        self._values = {label: SortedList(values) for label, values in parts.items()}


def _flat(values: Mapping[int, Sequence[float]], dtype: torch.dtype) -> dict[str, Tensor]:
    sizes = torch.tensor([0, *map(len, values.values())], dtype=torch.int64)
    return {
        "labels": torch.tensor([*values], dtype=torch.int64),
        "offsets": sizes.cumsum(0),
        "values": torch.tensor([value for known in values.values() for value in known], dtype=dtype),
    }


def _parts(state_dict: Mapping[str, Tensor]) -> dict[int, list[int]]:
    """The values of each class, from :func:`_flat`."""
    labels, offsets, values = (state_dict[name].tolist() for name in ("labels", "offsets", "values"))
    parts = [values[start:end] for start, end in pairwise(offsets)]
    whole = offsets[:1] == [0] and offsets[-1:] == [len(values)] and offsets == sorted(offsets)
    if not (whole and len(parts) == len(labels) == len(set(labels))):
        raise ValueError(
            f"Expected the values of {len(labels)} classes, got offsets that cut {len(values)} values otherwise: the "
            f"state is damaged, take an older one."
        )
    return dict(zip(labels, parts, strict=True))
