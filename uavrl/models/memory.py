"""A memory of the episode so far, for actors and critics that do not see all of the state at once."""

from __future__ import annotations

import copy
from typing import cast

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import GRUModule

from uavrl.models.actor_critic import as_weights
from uavrl_onboard.ranges import Count, Whole

RECURRENT_STATE = "recurrent_state"  # what a policy carries from step to step
MEMORY, CRITIC_MEMORY = "memory", "critic_memory"  # what the actor and the critics read of theirs
IS_INIT = "is_init"  # whether an episode begins


class GRUMemory(GRUModule):
    """TorchRL's GRU over the observations of an episode; actor and critics read its output beside the observation.

    Actor and critics have one each. It begins an episode at zero. While learning it reads windows of whole episodes:
    ``burn_in`` steps only fill it, the next ``length`` steps are learned from, and gradients pass through both. A
    window in the middle of an episode begins at zero, too.

    Source: Cho et al. (2014), arXiv:1406.1078, for the GRU; Kapturowski et al. (2019), Recurrent Experience Replay in
    Distributed Reinforcement Learning, for burn-in; Ni et al. (2022), Recurrent Model-Free RL Can Be a Strong Baseline
    for Many POMDPs (arXiv:2110.05038), for separate memories and the observation beside them.

    Args:
        observations: width of the observation.
        size: numbers in the memory.
        burn_in: steps that only fill it.
        length: steps that are learned from.

    Examples:
        >>> memory = GRUMemory(6, size=8)
        >>> memory.unroll(torch.zeros(5, 7, 6)).shape
        torch.Size([5, 7, 8])
    """

    def __init__(self, observations: int, size: Count = 128, *, burn_in: Whole = 16, length: Count = 16) -> None:
        in_keys, out_keys = ["observation", RECURRENT_STATE, IS_INIT], [MEMORY, ("next", RECURRENT_STATE)]
        super().__init__(observations, size, in_keys=in_keys, out_keys=out_keys)
        self.size, self.burn_in, self.length = size, burn_in, length

    def unroll(self, observations: Tensor) -> Tensor:
        """Return the memory ``[B, T, size]`` after each of the observations ``[B, T, S]``, which follows on nothing."""
        output, _ = self.gru(as_weights(observations, self.gru.weight_ih_l0))
        return cast(Tensor, output)

    def advance(self, observation: Tensor, state: Tensor) -> Tensor:
        """Return the state ``[B, size]`` after an observation ``[B, S]`` and a state, in plain operations.

        Those of an ONNX file: r, z and n are the reset gate, the update gate and the candidate of PyTorch's GRU.
        """
        weights = dict(self.gru.named_parameters())
        seen = nn.functional.linear(observation, weights["weight_ih_l0"], weights["bias_ih_l0"]).chunk(3, -1)
        kept = nn.functional.linear(state, weights["weight_hh_l0"], weights["bias_hh_l0"]).chunk(3, -1)
        r, z = (seen[0] + kept[0]).sigmoid(), (seen[1] + kept[1]).sigmoid()
        n = (seen[2] + r * kept[2]).tanh()
        return (1 - z) * n + z * state


class RecurrentPolicy(TensorDictSequential):
    """A memory and the policy that reads it beside the observation.

    It reads ``observation``, ``is_init`` and ``recurrent_state``, and writes ``action`` and the next
    ``recurrent_state``: TorchRL's ``InitTracker`` and ``TensorDictPrimer`` let an environment carry them.
    """

    def __init__(self, memory: GRUMemory, head: TensorDictModuleBase) -> None:
        super().__init__(memory, head)

    @property
    def memory(self) -> GRUMemory:
        """The memory."""
        return cast(GRUMemory, self.module[0])

    @property
    def head(self) -> TensorDictModuleBase:
        """The policy behind it."""
        return cast(TensorDictModuleBase, self.module[1])

    @property
    def recurrent_state(self) -> tuple[int, int]:
        """The shape of the state that a vehicle carries from step to step."""
        return 1, self.memory.size


def frozen_copy(memory: GRUMemory) -> GRUMemory:
    """Return a copy of a memory that no optimiser moves."""
    return copy.deepcopy(memory).requires_grad_(False)


def taken_at(values: Tensor, places: Tensor) -> Tensor:
    """Return values ``[B, W, D]`` at the places ``[B, T]`` of each row, end to end: ``[B * T, D]``.

    Examples:
        >>> taken_at(torch.tensor([[[1.0], [2.0]], [[3.0], [4.0]]]), torch.tensor([[1], [0]])).flatten().tolist()
        [2.0, 3.0]
    """
    return values[torch.arange(len(values), device=values.device)[:, None], places].flatten(0, 1)
