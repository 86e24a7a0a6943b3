"""The memory step by step, over a whole episode at once, and in plain operations."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from uavrl.models import Actor, GRUMemory, RecurrentPolicy
from uavrl.models.memory import MEMORY

SEEN = torch.randn(4, 9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float32)


def stepped(memory: GRUMemory, seen: torch.Tensor, *, begins_at: tuple[int, ...] = (0,)) -> torch.Tensor:
    """What is remembered after each step ``[B, T, size]``, as an environment carries it."""
    state, found = torch.full((len(seen), 1, memory.size), 0.7), []
    for step in range(seen.shape[1]):
        begins = torch.full((len(seen), 1), step in begins_at)
        read = TensorDict({"observation": seen[:, step], "recurrent_state": state, "is_init": begins}, [len(seen)])
        written = memory(read)
        state = written["next", "recurrent_state"]
        found.append(written[MEMORY])
    return torch.stack(found, 1)


def test_a_window_is_read_as_an_episode_is_flown() -> None:
    memory = GRUMemory(3, 5)
    torch.testing.assert_close(memory.unroll(SEEN), stepped(memory, SEEN))


def test_an_episode_knows_nothing_of_the_one_before() -> None:
    memory = GRUMemory(3, 5)
    remembered = stepped(memory, SEEN, begins_at=(0, 6))
    torch.testing.assert_close(remembered[:, 6:], memory.unroll(SEEN[:, 6:]))


def test_the_plain_operations_are_those_of_pytorchs_gru() -> None:
    memory = GRUMemory(3, 5)
    state = torch.zeros(4, 5)
    for step, wanted in enumerate(memory.unroll(SEEN).unbind(1)):
        state = memory.advance(SEEN[:, step], state)
        torch.testing.assert_close(state, wanted)


def test_a_policy_reads_memory_and_observation() -> None:
    memory = GRUMemory(3, 5)
    head = TensorDictModule(Actor(8, 2, (4,)), [MEMORY, "observation"], ["action"])
    policy = RecurrentPolicy(memory, head)
    assert set(policy.in_keys) == {"observation", "recurrent_state", "is_init"}
    assert policy.recurrent_state == (1, 5)
    begins = torch.ones(4, 1, dtype=torch.bool)
    read = TensorDict({"observation": SEEN[:, 0], "recurrent_state": torch.zeros(4, 1, 5), "is_init": begins}, [4])
    acted = policy(read)
    state = torch.cat([memory.unroll(SEEN[:, :1])[:, 0], SEEN[:, 0]], -1)
    torch.testing.assert_close(acted["action"], head.module(state))
