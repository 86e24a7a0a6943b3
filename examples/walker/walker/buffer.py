"""A replay buffer that a good policy does not fill with what it can do: falls always enter, successes rarely."""

from __future__ import annotations

from typing import Annotated, Any

import torch
from pydantic import Field
from tensordict import TensorDictBase

from uavrl.buffers import EpisodeBuffer
from uavrl_onboard.ranges import Count, Fraction


class FailureBias:
    """Leaves most successful episodes out (Wei & Ying (2020), their code for the hard-core walker).

    A success is stored with ``probability``, and only while the fall counter is positive. The counter grows by 1 with
    each fall and sinks by ``falls_per_success`` with each stored success.

    Args:
        success_return: return, as Gymnasium gives it, from which an episode without a fall is a success.
        probability: see above.
        falls_per_success: see above.
        updates_when_left_out: of all but actor and targets after an episode that is not stored.
        seed: of the coin.
    """

    def __init__(
        self,
        success_return: float = 250.0,
        probability: float = 0.5,
        falls_per_success: int = 10,
        updates_when_left_out: int = 100,
        seed: int = 0,
    ) -> None:
        self.success_return, self.probability = success_return, probability
        self.falls_per_success, self.updates_when_left_out = falls_per_success, updates_when_left_out
        self.falls = self.left_out = 0
        self._generator = torch.Generator().manual_seed(seed)

    def keeps(self, episode: TensorDictBase) -> bool:
        """Whether one whole episode ``[T]`` is stored; counts its fall."""
        last = episode[-1]["next"]
        fell = bool(last["collided"])
        success = not fell and float(last["episode_reward"]) >= self.success_return
        self.falls += fell
        coin = float(torch.rand((), generator=self._generator))
        kept = not success or (self.falls > 0 and coin < self.probability)
        self.falls -= self.falls_per_success * (success and kept)
        self.left_out += not kept
        return kept

    def diagnostics(self) -> dict[str, float]:
        """The fall counter, and how many episodes were left out."""
        return {"buffer_falls": float(self.falls), "buffer_left_out": float(self.left_out)}

    def state_dict(self) -> dict[str, Any]:
        """Counters and generator."""
        return {"falls": self.falls, "left_out": self.left_out, "generator": self._generator.get_state()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.falls, self.left_out = int(state_dict["falls"]), int(state_dict["left_out"])
        self._generator.set_state(state_dict["generator"].cpu())


class FailureBiasedBuffer(EpisodeBuffer):
    """A replay buffer with a :class:`FailureBias`."""

    reads = ("episode_reward", "collided")

    def __init__(
        self,
        capacity: Count = 1_000_000,
        success_return: float = 250.0,
        probability: Fraction = 0.5,
        falls_per_success: Annotated[int, Field(ge=0, le=1_000_000_000)] = 10,
        updates_when_left_out: Annotated[int, Field(ge=0, le=10_000)] = 100,
        seed: int = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(capacity, **kwargs)
        self.filter = FailureBias(success_return, probability, falls_per_success, updates_when_left_out, seed)
