from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from uavrl.buffers import EpisodeBuffer
from uavrl.training.replay import STORED_KEYS, EpisodeReplay


class Short:
    """Stores what takes fewer than six steps."""

    updates_when_left_out = 7

    def __init__(self) -> None:
        self.seen = 0

    def keeps(self, episode: TensorDictBase) -> bool:
        self.seen += 1
        return len(episode) < 6

    def diagnostics(self) -> dict[str, float]:
        return {"seen": float(self.seen)}

    def state_dict(self) -> dict[str, Any]:
        return {"seen": self.seen}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.seen = state_dict["seen"]


def filtering() -> EpisodeReplay:
    buffer = EpisodeBuffer(100)
    buffer.filter = Short()
    return EpisodeReplay(buffer, 2)


def episode(steps: int) -> TensorDict:
    last = torch.arange(steps)[:, None] == steps - 1
    flags = dict.fromkeys(("done", "terminated", "arrived", "collided"), last)
    after = {"observation": torch.zeros(steps, 2), "reward": torch.zeros(steps, 1), **flags, "wind": last}
    return TensorDict({"observation": torch.zeros(steps, 2), "action": torch.zeros(steps, 1), "next": after}, [steps])


def test_after_an_episode_that_is_left_out_come_a_few_updates() -> None:
    replay = filtering()
    told = []
    for batch in (episode(5), episode(9), torch.cat([episode(3), episode(8), episode(2)])):
        stored = replay.filtered(batch)
        assert set(stored.keys(True, True)) == set(STORED_KEYS)
        updates = replay.store(stored)
        told.append((len(stored), len(replay.buffer), updates, sum(1 for _ in replay.batches(updates))))
    assert told == [(5, 5, 5, 5), (0, 5, 7, 7), (5, 10, 5, 5)]


def test_nothing_is_learned_from_an_empty_buffer() -> None:
    replay = filtering()
    assert replay.store(replay.filtered(episode(9))) == 0


def test_the_filters_state_goes_into_checkpoints() -> None:
    one, other = filtering(), filtering()
    one.filtered(episode(9))
    other.load_state_dict(one.state_dict())
    assert other.diagnostics() == one.diagnostics() == {"seen": 1.0}
    assert EpisodeReplay(EpisodeBuffer(9), 2).diagnostics() == {}
