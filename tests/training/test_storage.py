"""The storage gives what TorchRL's gives."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage

from uavrl.training.storage import GatheringStorage


def filled(storage: LazyTensorStorage) -> LazyTensorStorage:
    data = {"reward": torch.arange(6.0)[:, None], "next": {"done": torch.arange(6) % 2 == 0}}
    storage.set(torch.arange(6), TensorDict(data, [6]))
    return storage


@pytest.mark.parametrize(
    "index",
    [torch.tensor([4, 0, 4]), torch.tensor([-1]), torch.tensor([], dtype=torch.long), torch.arange(6) > 2, 3, slice(2)],
)
def test_it_gives_what_torchrls_gives(index: Any) -> None:
    ours, theirs = (filled(kind(10)).get(index) for kind in (GatheringStorage, LazyTensorStorage))
    assert ours.batch_size == theirs.batch_size and ours["next"].batch_size == theirs["next"].batch_size
    assert (ours == theirs).all()


@pytest.mark.parametrize("index", [torch.tensor([0, 6]), torch.tensor([-7])])
def test_what_is_not_there_is_refused(index: torch.Tensor) -> None:
    with pytest.raises(IndexError):
        filled(GatheringStorage(10)).get(index)


def test_plain_tensors_can_be_stored() -> None:
    storage = GatheringStorage(10)
    storage.set(torch.arange(3), torch.arange(3.0))
    assert storage.get(torch.tensor([2, 0])).tolist() == [2.0, 0.0]
