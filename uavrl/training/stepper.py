"""One optimisation step of a deterministic actor–critic."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import SoftUpdate
from torchrl.trainers import OptimizationStepper, Trainer

from uavrl.training.factory import Loss


def _adam(parameters: Any, lr: float) -> torch.optim.Adam:
    leaves = [p for p in parameters.values(True, True) if isinstance(p, Tensor)]
    return torch.optim.Adam(leaves, lr=lr, fused=True)


class ActorCriticStepper(OptimizationStepper):
    """Critic every step; actor and target networks every ``policy_delay`` steps (Algorithm 3.1).

    Args:
        loss: gives ``value_loss(batch)`` and ``actor_loss(batch)``.
        actor_lr: Adam's step for the actor.
        critic_lr: Adam's step for the critics.
        policy_delay: critic steps for each step of actor and targets.
        tau: share of the online networks in each target update (Eq. 2.9).
    """

    updates_replay_priority = True

    def __init__(
        self,
        loss: Loss,
        *,
        actor_lr: float = 1e-4,
        critic_lr: float = 1e-3,
        policy_delay: int = 2,
        tau: float = 0.005,
    ) -> None:
        super().__init__()
        self.loss = loss
        self.policy_delay = policy_delay
        self.actor_optimizer = _adam(loss.actor_network_params, actor_lr)
        self.critic_optimizer = _adam(loss.critic_network_params, critic_lr)
        self.targets = SoftUpdate(loss, tau=tau)
        self.updates = 0
        self._actor_loss = torch.zeros(())

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates the networks on one batch and writes the new priorities into it.

        Returns:
            The detached losses and the mean value of the batch.
        """
        value_loss, metadata = self.loss.value_loss(sub_batch)
        self._descend(self.critic_optimizer, value_loss)
        squared_error = metadata["td_error"].detach()
        squared_error = squared_error.amax(0) if squared_error.ndim > 1 else squared_error
        sub_batch.set("td_error", squared_error.sqrt())  # Eq. 2.17: the priority is the absolute error
        self.updates += 1
        if self.updates % self.policy_delay == 0:
            actor_loss, _ = self.loss.actor_loss(sub_batch)
            self._descend(self.actor_optimizer, actor_loss)
            self.targets.step()
            self._actor_loss = actor_loss.detach()
        return TensorDict(
            {
                "loss_value": value_loss.detach(),
                "loss_actor": self._actor_loss,
                "value": metadata["pred_value"].detach().mean(),
            }
        )

    @staticmethod
    def _descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    def state_dict(self) -> dict[str, Any]:
        """Optimisers and the update counter; the networks are the loss module's."""
        return {
            "actor_optimizer": self.actor_optimizer.state_dict(),
            "critic_optimizer": self.critic_optimizer.state_dict(),
            "updates": self.updates,
            "actor_loss": self._actor_loss,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.actor_optimizer.load_state_dict(state_dict["actor_optimizer"])
        self.critic_optimizer.load_state_dict(state_dict["critic_optimizer"])
        self.updates = state_dict["updates"]
        self._actor_loss = state_dict["actor_loss"].clone()
