"""An actor penalty of one's own with a model of its own, which it says how to train."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import binary_cross_entropy_with_logits

from uavrl.losses import ActorCriticLoss, ActorPenalty, AuxiliaryModel
from uavrl_onboard.ranges import NonNegative, Positive


class Wary(ActorPenalty):
    """Actions that are likely to end the flight cost: ``weight P(s, a)``, where P is learned from each batch.

    Args:
        base: the loss to add the term to.
        observations: width of the state.
        actions: width of the action.
        weight: of the cost.
        model_lr: Adam's step for the model.
    """

    def __init__(
        self, base: ActorCriticLoss, *, observations: int, actions: int, weight: NonNegative = 1.0,
        model_lr: Positive = 1e-3,
    ) -> None:  # fmt: skip
        super().__init__(base)
        self.weight, self.model_lr = weight, model_lr
        self.model = nn.Sequential(nn.Linear(observations + actions, 16), nn.ReLU(), nn.Linear(16, 1))

    @property
    def models(self) -> list[AuxiliaryModel]:
        """One, trained at each update."""
        return [AuxiliaryModel(parameters=list(self.model.parameters()), lr=self.model_lr, loss=self.ending_loss)]

    def ending_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """How far P is from what happened."""
        logits = self.model(torch.cat([batch["observation"], batch["action"]], -1))
        return binary_cross_entropy_with_logits(logits, batch["next", "terminated"].float()), {}

    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The cost of each sample ``[*B]``; the model is constant."""
        constants = {name: value.detach() for name, value in self.model.named_parameters()}
        logits = functional_call(self.model, constants, (torch.cat([acted["observation"], acted["action"]], -1),))
        cost = self.weight * logits.sigmoid().squeeze(-1)
        return cost, {"wary_cost": cost.detach()}
