"""FORK as its authors run it on the hard-core walker (Wei & Ying (2020), their code)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import unravel_key
from torch import Tensor

from uavrl.losses import Fork


class BipedalFork(Fork):
    """No reward network, target critics throughout the actor's loss, and a system loss without last steps.

    To the actor's objective, which is ``-Q'(s, μ(s))`` here, comes ``-w Q'(s1, μ(s1)) - 0.5 w Q'(s2, μ(s2))``.
    """

    predicts_rewards = False

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's, by the target critics, and the term while the gate is open."""
        return super().actor_objective(acted, target=True)

    def look_ahead(self, acted: TensorDictBase, first: TensorDictBase, second: TensorDictBase) -> Tensor:
        """What comes to the objective of each sample ``[*B]``."""
        q_tp1, q_tp2 = self.action_value(first, target=True), self.action_value(second, target=True)
        return -self.weight * (q_tp1 + 0.5 * q_tp2)

    def system_errors(self, prediction: Tensor, target: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Squared errors ``[*B]`` of predicted next states, 0 where an episode ends."""
        done = tensordict.get(unravel_key(("next", self.tensor_keys.done))).reshape(tensordict.batch_size)
        return torch.where(done, 0.0, (prediction - target).square().mean(-1))
