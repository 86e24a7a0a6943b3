"""What the backward reward remembers: the distinct sums seen in each class of trajectories, sorted."""

from collections.abc import Mapping
from itertools import pairwise
from operator import index

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

    def __init__(self) -> None:
        self._values: dict[int, SortedList] = {}

    def __len__(self) -> int:
        """How many values are stored, in all classes together."""
        return sum(map(len, self._values.values()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}(classes={len(self._values)}, values={len(self)})"

    @property
    def classes(self) -> list[int]:
        """The classes seen, in ascending order."""
        return sorted(self._values)

    def values(self, label: int) -> list[int]:
        """The distinct values of a class in ascending order; none for a class not seen."""
        return list(self._values.get(label, ()))

    def insert_and_rank(self, label: int, value: int) -> int:
        """Inserts a value into its class, unless it is there, and tells its place (Algorithm 3.1, "return m").

        Args:
            label: the class l.
            value: the floored sum R.

        Returns:
            m: how many values of the class are smaller.

        Raises:
            TypeError: when either is no integer.
        """
        label, value = index(label), index(value)
        known = self._values.setdefault(label, SortedList())
        rank = known.bisect_left(value)
        if rank == len(known) or known[rank] != value:
            known.add(value)
        return rank

    def state_dict(self) -> dict[str, Tensor]:
        """Everything as three flat int64 tensors.

        Returns:
            ``labels [C]`` in ascending order, ``values [M]`` class after class, and ``offsets [C + 1]``: the
            values of class ``labels[c]`` are ``values[offsets[c] : offsets[c + 1]]``.
        """
        lists = [self._values[label] for label in self.classes]
        sizes = torch.tensor([0, *map(len, lists)], dtype=torch.int64)
        return {
            "labels": torch.tensor(self.classes, dtype=torch.int64),
            "offsets": sizes.cumsum(0),
            "values": torch.tensor([value for known in lists for value in known], dtype=torch.int64),
        }

    def load_state_dict(self, state_dict: Mapping[str, Tensor]) -> None:
        """Replaces everything by what :meth:`state_dict` gave.

        Raises:
            ValueError: when the tensors do not fit together.
        """
        labels, offsets, values = (state_dict[name].tolist() for name in ("labels", "offsets", "values"))
        parts = [values[start:end] for start, end in pairwise(offsets)]
        whole = offsets[:1] == [0] and offsets[-1:] == [len(values)] and offsets == sorted(offsets)
        if not (whole and len(parts) == len(labels) == len(set(labels)) and all(map(_ascends, parts))):
            raise ValueError(
                f"Expected {len(labels)} classes whose values ascend, got offsets that cut {len(values)} values "
                f"otherwise: the state is damaged, take an older one."
            )
        self._values = {label: SortedList(part) for label, part in zip(labels, parts, strict=True)}


def _ascends(values: list[int]) -> bool:
    return all(a < b for a, b in pairwise(values))
