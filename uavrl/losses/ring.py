"""A bounded first-in-first-out store that lives in a state dict."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Ring(nn.Module):
    """Keeps the last ``capacity`` rows it is given.

    Args:
        capacity: the largest number of rows.
        shape: shape of one row.
        dtype: type of the rows.

    Raises:
        ValueError: if ``capacity`` is not positive.

    Examples:
        >>> ring = Ring(3, ())
        >>> ring.push(torch.arange(5.0))
        >>> len(ring), sorted(ring.stored.tolist()), int(ring.seen)
        (3, [2.0, 3.0, 4.0], 5)
    """

    rows: Tensor
    seen: Tensor

    def __init__(self, capacity: int, shape: tuple[int, ...] = (), dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        if capacity < 1:
            raise ValueError(f"Expected room for at least one row, got a capacity of {capacity}.")
        self.register_buffer("rows", torch.zeros(capacity, *shape, dtype=dtype))
        self.register_buffer("seen", torch.zeros((), dtype=torch.int64))

    def __len__(self) -> int:
        return min(int(self.seen), len(self.rows))

    @property
    def stored(self) -> Tensor:
        """The rows kept, ``[len(self), *shape]``, in no particular order."""
        return self.rows[: len(self)]

    def push(self, rows: Tensor) -> None:
        """Adds rows ``[N, *shape]``; the oldest give way."""
        kept = rows[-len(self.rows) :]
        first = int(self.seen) + len(rows) - len(kept)
        index = torch.arange(first, first + len(kept), device=self.rows.device) % len(self.rows)
        self.rows[index] = kept.detach().to(self.rows)
        self.seen += len(rows)

    def clear(self) -> None:
        """Forgets all rows."""
        self.rows.zero_()
        self.seen.zero_()
