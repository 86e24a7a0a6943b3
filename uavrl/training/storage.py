"""Where transitions lie."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage


class GatheringStorage(LazyTensorStorage):
    """TorchRL's storage, which copies the rows of a random batch one by one instead of number by number.

    ``tensor.index_select`` reads a transition as one piece; ``tensor[index]`` does not and takes about twice as long.

    Examples:
        >>> from tensordict import TensorDict
        >>> storage = GatheringStorage(10)
        >>> storage.set(torch.arange(3), TensorDict({"reward": torch.tensor([1.0, 2.0, 3.0])}, [3]))
        >>> storage.get(torch.tensor([2, 0]))["reward"]
        tensor([3., 1.])
    """

    def get(self, index: Any) -> Any:
        """The transitions at ``index``, which may be anything that a tensor takes."""
        asks_rows = isinstance(index, Tensor) and index.ndim == 1 and index.dtype == torch.long and len(index) > 0
        holds_rows = self.initialized and isinstance(self._storage, TensorDictBase) and self.ndim == 1
        if not (asks_rows and holds_rows and 0 <= int(index.min()) <= int(index.max()) < len(self)):
            return super().get(index)
        rows = index.to(self.device)
        return self._storage._fast_apply(lambda stored: stored.index_select(0, rows), batch_size=[len(index)])
