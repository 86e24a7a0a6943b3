"""ABR and ABR⁺ in somebody else's project: their keys, their sizes, and how they show themselves."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.checkpoint import Checkpoint
from torchrl.data import LazyTensorStorage, ReplayBuffer

from uavrl.buffers import ABR, ABRPlus, BackwardReward
from uavrl.buffers.functional import stacked_frames
from uavrl.entries import MissingEntry
from uavrl.errors import UavrlError
from uavrl.models import OneShotClassifier

REWARD = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 7.0]


def stacked(steps: int, frames: int, width: int, seed: int = 0) -> Tensor:
    """States ``[steps, frames * width]`` as CatFrames makes them, zeros before the first."""
    seen = torch.randn(steps, width, generator=torch.Generator().manual_seed(seed))
    seen = torch.cat([torch.zeros(frames - 1, width), seen])
    return torch.stack([seen[step : step + frames].flatten() for step in range(steps)])


def episode(
    states: Tensor, *, success: bool = True, observation: str = "observation", arrived: str = "arrived"
) -> TensorDict:
    last = torch.arange(len(states))[:, None] == len(states) - 1
    reward = torch.tensor([REWARD[step % 7] for step in range(len(states))])[:, None]
    after = {"reward": reward, "done": last, arrived: last & success}
    return TensorDict({observation: states, "next": after}, [len(states)])


def rewards(data: TensorDictBase) -> list[float]:
    return data["next", "reward"].flatten().tolist()


@pytest.mark.parametrize(("frames", "width"), [(2, 5), (3, 35), (3, 2), (4, 3)])
def test_sizes_are_read_off_the_first_episode(frames: int, width: int) -> None:
    """An episode that fails is enough, and the result is that of sizes that were told."""
    told, found = ABR(stacked=frames, observations=frames * width, threshold=0.5), ABR(threshold=0.5)
    for seed, success in enumerate([False, True, True]):
        data = episode(stacked(14, frames, width, seed), success=success)
        assert rewards(found.inv(data.clone())) == rewards(told.inv(data.clone()))
    assert isinstance(found.classifier, OneShotClassifier)
    assert (found.frames, found.classifier.weight.shape[1]) == (frames, width)
    assert found.episodes == 2 and found.mean_extra > 0


def test_on_the_thesiss_sizes_the_classes_repeat() -> None:
    """Classes and extra rewards that the same settings gave before sizes were read off an episode."""
    states = stacked(30, 3, 35)
    labels = OneShotClassifier(width=35, frames=3, features=20, threshold=0.9)(states[2::3])
    transform = ABR(threshold=0.9)
    transform.inv(episode(states))
    assert torch.equal(transform.classifier(states[2::3]), labels)


def test_a_part_of_the_sizes_can_be_told() -> None:
    constant = torch.ones(6, 12)
    transform = ABR(stacked=4)
    transform.inv(episode(constant))
    assert isinstance(transform.classifier, OneShotClassifier) and transform.classifier.weight.shape[1] == 3
    with pytest.raises(UavrlError, match="split a state of 12 numbers into 5"):
        ABR(stacked=5).inv(episode(constant))
    with pytest.raises(UavrlError, match=r"expected states \[T, 105\], got \[6, 12\]: check observation="):
        ABR(observations=105).inv(episode(constant))


def test_what_is_not_stacked_or_cannot_be_told_is_refused() -> None:
    with pytest.raises(
        UavrlError, match="these states of 12 numbers are not stacked: stack observations with CatFrames"
    ):
        ABR().inv(episode(torch.randn(7, 12)))
    undecided = ABR()
    undecided.inv(episode(torch.zeros(7, 12), success=False))  # nothing has to be classified
    with pytest.raises(UavrlError, match="cannot tell how many observations are stacked in a state of 12 numbers"):
        undecided.inv(episode(torch.zeros(7, 12)))
    undecided.inv(episode(stacked(7, 3, 4)))
    assert undecided.frames == 3


def test_episodes_of_one_step_decide_nothing() -> None:
    transform = ABR()
    transform.inv(torch.cat([episode(stacked(1, 2, 4)), episode(stacked(1, 2, 4))]))
    assert not isinstance(transform.classifier, OneShotClassifier)
    transform.inv(torch.cat([episode(stacked(1, 2, 4)), episode(stacked(5, 2, 4))]))
    assert transform.frames == 2


def test_stacked_frames_compares_within_episodes() -> None:
    states = torch.cat([stacked(4, 3, 2, seed) for seed in (0, 1)])
    done = torch.tensor([False, False, False, True] * 2)
    assert stacked_frames(states, done) == [3]
    assert stacked_frames(states, torch.arange(8) == 7) == []


@pytest.mark.parametrize("make", [ABR, lambda **keys: ABRPlus(artifact="packaged", **keys)])
def test_all_keys_can_be_named(make) -> None:
    keys = {
        "observation": "state",
        "reward": ("next", "gain"),
        "arrived": ("next", "success"),
        "done": ("next", "over"),
    }
    data = episode(stacked(14, 3, 35), observation="state", arrived="success")
    data["next"].rename_key_("reward", "gain").rename_key_("done", "over")
    plain, named = make(), make(**keys, reward_raw=("next", "before"))
    expected = rewards(plain.inv(episode(stacked(14, 3, 35))))
    out = named.inv(data)
    assert out["next", "gain"].flatten().tolist() == expected
    assert out["next", "before"].flatten().tolist() == REWARD * 2
    with pytest.raises(MissingEntry, match=r"reads \('next', 'arrived'\), but the data contain only .*'success'"):
        make(observation="state", reward=("next", "gain"), done=("next", "over")).inv(data)


def test_abr_plus_refuses_states_of_another_width_at_the_first_write() -> None:
    with pytest.raises(
        UavrlError, match=r"artifact packaged classifies states of 105 numbers, these have 12: make one"
    ):
        ABRPlus().inv(episode(stacked(7, 3, 4), success=False))
    assert ABRPlus().frames == 3


@pytest.mark.parametrize("begun", [True, False])
def test_a_checkpoint_brings_the_sizes(begun: bool, tmp_path: Path) -> None:
    """Into a new ABR, and into one that has met other states."""
    one = ABR(threshold=0.5)
    if begun:
        one.inv(episode(stacked(14, 2, 6)))
    Checkpoint(abr=one, format="archive").save(tmp_path / "state.zip")
    for met in (None, stacked(14, 2, 6, seed=5)):
        other = ABR(threshold=0.5)
        if met is not None:
            other.inv(episode(met))
        Checkpoint(abr=other, format="archive").load(tmp_path / "state.zip", map_location="cpu")
        following = episode(stacked(20, 2, 6, seed=9))
        expected = ABR(threshold=0.5)
        expected.load_state_dict(one.state_dict())
        assert rewards(other.inv(following.clone())) == rewards(expected.inv(following.clone()))
        assert other.frames == expected.frames == 2


def test_a_buffers_state_dict_brings_the_sizes() -> None:
    buffers = [ReplayBuffer(storage=LazyTensorStorage(50), batch_size=8, transform=ABR()) for _ in range(2)]
    buffers[0].extend(episode(stacked(14, 2, 6)))
    buffers[1].load_state_dict(buffers[0].state_dict())
    restored = buffers[1].transform[0]
    assert isinstance(restored, ABR) and restored.frames == 2 and restored.episodes == 1


def by_sign(states: Tensor) -> Tensor:
    return (states[:, 0] > 0).long()


@pytest.mark.parametrize(
    ("made", "shown"),
    [
        (lambda: ABR(), "ABR()"),
        (lambda: ABR(0.5, arrived=("next", "success")), "ABR(multiplier=0.5, arrived=('next', 'success'))"),
        (lambda: ABRPlus(multiplier=0.1), "ABRPlus(multiplier=0.1)"),
        (lambda: BackwardReward(by_sign, frames=2), "BackwardReward(classifier=by_sign, frames=2)"),
        (lambda: BackwardReward(OneShotClassifier()), "BackwardReward(classifier=OneShotClassifier(...))"),
    ],
)
def test_a_backward_reward_shows_its_constructor_call(made, shown: str) -> None:
    assert repr(made()) == shown
