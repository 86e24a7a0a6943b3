"""A term of the actor's objective of one's own; it attaches to TD3, DDPG and SAC alike."""

from __future__ import annotations

from tensordict import TensorDictBase
from torch import Tensor

from uavrl.losses import ActorCriticLoss, ActorPenalty
from uavrl_onboard.ranges import NonNegative


class Calm(ActorPenalty):
    """Large actions cost: ``weight |a|²`` comes to what the actor minimises.

    Args:
        base: the loss to add the term to.
        weight: of the cost.
    """

    def __init__(self, base: ActorCriticLoss, *, weight: NonNegative = 0.1) -> None:
        super().__init__(base)
        self.weight = weight

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The cost of each sample ``[*B]``."""
        cost = self.weight * acted["action"].square().sum(-1)
        return cost, {"calm_cost": cost.detach()}
