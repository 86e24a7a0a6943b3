"""The storages give what TorchRL's gives, bit by bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from uavrl.buffers import FrameStorage, GatheringStorage


def filled(storage: LazyTensorStorage) -> LazyTensorStorage:
    data = {"reward": torch.arange(6.0)[:, None], "next": {"done": torch.arange(6) % 2 == 0}}
    following = {**data["next"], "observation": torch.arange(6.0)[:, None] + 1}
    storage.set(
        torch.arange(6), TensorDict({**data, "observation": torch.arange(6.0)[:, None], "next": following}, [6])
    )
    return storage


@pytest.mark.parametrize("kind", [GatheringStorage, FrameStorage])
@pytest.mark.parametrize(
    "index",
    [torch.tensor([4, 0, 4]), torch.tensor([-1]), torch.tensor([], dtype=torch.long), torch.arange(6) > 2, 3, slice(2)],
)
def test_it_gives_what_torchrls_gives(kind: type[LazyTensorStorage], index: Any) -> None:
    ours, theirs = (filled(kind(10)).get(index) for kind in (kind, LazyTensorStorage))
    assert ours.batch_size == theirs.batch_size and ours["next"].batch_size == theirs["next"].batch_size
    assert set(ours.keys(True, True)) == set(theirs.keys(True, True))
    assert (ours == theirs).all()


@pytest.mark.parametrize("kind", [GatheringStorage, FrameStorage])
@pytest.mark.parametrize("index", [torch.tensor([0, 6]), torch.tensor([-7])])
def test_what_is_not_there_is_refused(kind: type[LazyTensorStorage], index: torch.Tensor) -> None:
    with pytest.raises(IndexError):
        filled(kind(10)).get(index)


def test_plain_tensors_can_be_gathered() -> None:
    storage = GatheringStorage(10)
    storage.set(torch.arange(3), torch.arange(3.0))
    assert storage.get(torch.tensor([2, 0])).tolist() == [2.0, 0.0]


# ---------------------------------------------------------------------- each frame once


def episode(steps: int, frames: int, seed: int, width: int = 2, dtype: torch.dtype = torch.float32) -> TensorDict:
    """One episode: ``frames`` stacked frames, zeros before the first."""
    generator = torch.Generator().manual_seed(seed)
    frame = torch.randn(steps + 1, width, generator=generator, dtype=dtype)
    padded = torch.cat([torch.zeros(frames - 1, width, dtype=dtype), frame])
    states = padded.unfold(0, frames, 1).transpose(1, 2).flatten(1).clone()
    after = {
        "observation": states[1:].clone(),
        "reward": torch.randn(steps, 1, generator=generator),
        "done": torch.arange(steps)[:, None] == steps - 1,
    }
    return TensorDict(
        {"observation": states[:-1], "action": torch.randn(steps, 3, generator=generator), "next": after}, [steps]
    )


def bits(data: TensorDict) -> dict[Any, bytes]:
    return {key: value.contiguous().numpy().tobytes() for key, value in data.items(True, True)}


def pair(capacity: int, frames: int) -> tuple[TensorDictReplayBuffer, TensorDictReplayBuffer]:
    return tuple(
        TensorDictReplayBuffer(storage=storage, batch_size=4)
        for storage in (FrameStorage(capacity, frames), LazyTensorStorage(capacity))
    )


WRITES = st.lists(st.lists(st.integers(1, 12), min_size=1, max_size=4), min_size=1, max_size=12)


@settings(max_examples=40, deadline=None)
@given(writes=WRITES, capacity=st.integers(1, 60), frames=st.integers(1, 4), seed=st.integers(0, 9))
def test_whatever_is_written_comes_back(writes: list[list[int]], capacity: int, frames: int, seed: int) -> None:
    ours, theirs = pair(capacity, frames)
    generator = torch.Generator().manual_seed(seed)
    for number, lengths in enumerate(writes):
        data = torch.cat([episode(n, frames, 100 * number + i) for i, n in enumerate(lengths)])[:capacity]
        for buffer in (ours, theirs):
            buffer.extend(data.clone())
        assert bits(ours[:]) == bits(theirs[:])
        index = torch.randint(len(theirs), (7,), generator=generator)
        assert bits(ours[index]) == bits(theirs[index])
    other = FrameStorage(capacity, frames)
    other.load_state_dict(ours.storage.state_dict())
    assert bits(other[:]) == bits(theirs[:])
    kept = len(ours.storage.state_dict()["frames"])
    runs = 1 + int((theirs[:]["next", "observation"][:-1] != theirs[:]["observation"][1:]).any(1).sum())
    assert kept <= len(theirs) + frames * (runs + 1)  # and those of a run that is cut by the end of the ring


@settings(max_examples=30, deadline=None)
@given(lengths=st.lists(st.integers(1, 9), min_size=1, max_size=9), capacity=st.integers(1, 30), seed=st.integers(0, 9))
def test_any_place_can_be_written(lengths: list[int], capacity: int, seed: int) -> None:
    ours, theirs = FrameStorage(capacity, 3), LazyTensorStorage(capacity)
    generator = torch.Generator().manual_seed(seed)
    for storage in (ours, theirs):  # TorchRL's has no length before something is written in order
        storage.set(torch.arange(capacity), torch.cat([episode(1, 3, i) for i in range(capacity)]))
    for i, steps in enumerate(lengths):
        data = episode(steps, 3, i)[:capacity]
        where = torch.randperm(capacity, generator=generator)[: len(data)]
        for storage in (ours, theirs):
            storage[where] = data
        assert bits(ours[:]) == bits(theirs[:])


def test_single_steps_share_their_frames_too() -> None:
    ours, theirs = pair(50, 3)
    for i in range(4):
        for step in episode(5, 3, i):
            for buffer in (ours, theirs):
                buffer.add(step.clone())
    assert bits(ours[:]) == bits(theirs[:])
    assert len(ours.storage.state_dict()["frames"]) == 4 * (5 + 3)


@pytest.mark.parametrize("special", [float("nan"), -0.0, float("inf"), 1e-42])
def test_numbers_that_do_not_compare_as_they_are_come_back(special: float) -> None:
    data = episode(4, 2, 0)
    data["observation"][2, 2:] = data["next", "observation"][1, 2:] = special
    data["next", "observation"][2, :2] = special
    data["observation"][3, :2] = 0.0 if special == 0 else special  # -0 is not the bits of 0
    data["observation"][3, 2:] = data["next", "observation"][3, :2]
    ours, theirs = pair(10, 2)
    for buffer in (ours, theirs):
        buffer.extend(data.clone())
    assert bits(ours[:]) == bits(theirs[:])


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.uint8])
def test_the_type_of_the_observations_is_kept_and_their_key_may_be_nested(dtype: torch.dtype) -> None:
    data = episode(6, 3, 0).rename_key_("observation", ("uav", "state"))
    data.rename_key_(("next", "observation"), ("next", "uav", "state"))
    for key in (("uav", "state"), ("next", "uav", "state")):
        data[key] = (data[key] * 50).to(dtype)
    storage = FrameStorage(10, 3, observation=("uav", "state"))
    storage.set(range(6), data)
    assert storage[:]["uav", "state"].dtype == dtype
    assert all(torch.equal(storage[:][key], value) for key, value in data.items(True, True))


def test_a_full_storage_needs_little_more_than_a_frame_for_each_transition() -> None:
    storage = FrameStorage(500, 3)
    buffer = TensorDictReplayBuffer(storage=storage, batch_size=4)
    for i in range(30):
        buffer.extend(episode(60, 3, i))
    assert len(storage) == 500
    assert len(storage._ring) == 500 * 17 // 16
    for i in range(100):  # shorter episodes have more first states
        buffer.extend(episode(6, 3, i))
    assert 500 * 9 // 6 <= len(storage._ring) <= 500 * 9 // 6 * 1.25


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (torch.zeros(3), TypeError, "as a TensorDict, got Tensor"),
        (TensorDict({"observation": torch.zeros(3, 6)}, [3]), KeyError, r"\('next', 'observation'\)"),
        (TensorDict({"observation": torch.zeros(3, 7), "next": {}}, [3]), ValueError, r"3 frames, got \[3, 7\]"),
    ],
)
def test_what_cannot_be_stored_is_refused(data: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        FrameStorage(10, 3).set(range(3), data)
    with pytest.raises(ValueError, match="states of 2 frames, got those of 3"):
        FrameStorage(10, 2).load_state_dict(FrameStorage(10, 3).state_dict())


@pytest.mark.parametrize("episodes", [2, 9])  # before and after the first overwriting
def test_it_goes_on_from_its_dump_as_if_never_stopped(tmp_path: Path, episodes: int) -> None:
    def dumped(storage: FrameStorage, name: str) -> dict[Path, bytes]:
        storage.dumps(tmp_path / name)
        files = (tmp_path / name).rglob("*.memmap")
        return {file.relative_to(tmp_path / name): file.read_bytes() for file in files}

    storages = [FrameStorage(50, 3)]
    cursor = 0
    for i in range(2 * episodes):
        if i == episodes:
            storages[0].dumps(tmp_path / "middle")
            storages.append(FrameStorage(50, 3))
            storages[1].loads(tmp_path / "middle")
        for storage in storages:
            storage.set((cursor + torch.arange(11)) % 50, episode(11, 3, i))
        cursor = (cursor + 11) % 50
    whole, resumed = (dumped(storage, str(i)) for i, storage in enumerate(storages))
    assert len(whole) == 6
    assert whole == resumed


@pytest.mark.parametrize(("capacity", "before"), [(30, 0), (30, 4), (10, 3)])
def test_after_a_refused_write_nothing_is_read_that_was_not_written(capacity: int, before: int) -> None:
    ours, _ = pair(capacity, 3)
    if before:
        ours.extend(episode(before, 3, 0))
    wrong, right = episode(5, 3, 1), episode(5, 3, 2)
    wrong["next", "observation"][2, 0] += 1
    with pytest.raises(ValueError, match=r"moved up by one of 3 frames.*frames=1"):
        ours.extend(wrong.clone())
    assert len(ours) == before
    with pytest.raises(ValueError, match="a write before this one was refused"):
        ours.extend(right.clone())
    ours.empty()
    ours.extend(right.clone())
    assert len(ours) == 5 and bits(ours[:].exclude("index")) == bits(right)
    whole = FrameStorage(10, 1)
    whole.set(range(5), wrong)
    assert bits(whole[:]) == bits(wrong)


def test_an_empty_storage_has_a_state_too(tmp_path: Path) -> None:
    empty, filled = FrameStorage(20, 3), FrameStorage(20, 3)
    empty.dumps(tmp_path / "empty")
    for load in (lambda: filled.loads(tmp_path / "empty"), lambda: filled.load_state_dict(empty.state_dict())):
        filled.set(range(4), episode(4, 3, 0))
        load()
        assert len(filled) == 0
    filled.set(range(4), episode(4, 3, 1))
    assert bits(filled[:]) == bits(episode(4, 3, 1))
