"""One optimisation step of an actor–critic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import SoftUpdate
from torchrl.trainers import OptimizationStepper, Trainer

from uavrl.losses import ActorCriticLoss, Enhancer, Fork, LifeGuard, SACLoss
from uavrl.ranges import Count, Positive, Share
from uavrl.training.adam import DirectAdam
from uavrl.training.gradients import Execution, Gradients, LossGradients, LossMethod
from uavrl.upstream import lerp


class FusedSoftUpdate(SoftUpdate):
    """TorchRL's soft update (Eq. 2.9: ``θ' ← τ θ + (1 - τ) θ'``) of all parameters in one call."""

    def step(self) -> None:
        """Moves the targets."""
        if self._pairs is None:
            self._pairs = [
                (source.data, self._targets[(f"target_{key[0]}", *key[1:])].data)
                for key, source in self._sources.items(True, True)
            ]
        sources, targets = zip(*self._pairs, strict=True)
        lerp(list(targets), list(sources), 1 - self.eps)

    _pairs: list[tuple[Tensor, Tensor]] | None = None


class Descent:
    """Adam on what a loss method says about some parameters.

    Args:
        gradients: the loss and its gradients.
        lr: Adam's step.
    """

    def __init__(self, gradients: LossGradients, lr: float) -> None:
        self.gradients = gradients
        self.optimizer = DirectAdam(gradients.parameters, lr=lr)

    def __call__(self, batch: TensorDictBase) -> Gradients:
        """One step; returns what it was based on."""
        result = self.gradients(batch)
        for parameter, gradient in zip(self.gradients.parameters, result.gradients, strict=True):
            parameter.grad = gradient  # for whoever wants to look
        self.optimizer.descend(result.gradients)
        return result


class ActorCriticStepper(OptimizationStepper):
    """Critic and models every step; actor and target networks every ``policy_delay`` steps (Algorithm 3.1).

    While ``actor_learns`` is false, actor and targets stay as they are.

    Args:
        loss: gives ``value_loss(batch)`` and ``actor_loss(batch)``; may be enhanced by FORK and LifeGuard.
        actor_lr: Adam's step for the actor.
        critic_lr: Adam's step for the critics.
        temperature_lr: Adam's step for SAC's temperature.
        policy_delay: critic steps for each step of actor and targets.
        tau: share of the online networks in each target update (Eq. 2.9).
        execution: how losses are run: ``"eager"``, ``"captured"`` or ``"compiled"``.
    """

    updates_replay_priority = True

    def __init__(
        self,
        loss: ActorCriticLoss,
        *,
        actor_lr: Positive = 1e-4,
        critic_lr: Positive = 1e-3,
        temperature_lr: Positive = 3e-4,
        policy_delay: Count = 2,
        tau: Share = 0.005,
        execution: Execution = "captured",
    ) -> None:
        super().__init__()
        self.loss = loss
        self.policy_delay = policy_delay
        keys = (loss.unenhanced.tensor_keys.priority_weight, loss.value_estimator.tensor_keys.steps_to_next_obs)
        in_keys = [*loss.in_keys, *keys]

        def descent(method: LossMethod, parameters: Iterable[Any], lr: float, mode: Callable = tuple) -> Descent:
            leaves = [p for p in parameters if isinstance(p, Tensor) and p.requires_grad]  # no buffers
            return Descent(LossGradients(method, leaves, in_keys, execution, mode), lr)

        self.critic = descent(self._value_loss, loss.critic_network_params.values(True, True), critic_lr)
        actor_params = loss.actor_network_params.values(True, True)
        self.actor = descent(loss.actor_loss, actor_params, actor_lr, lambda: loss.mode)
        self.targets = FusedSoftUpdate(loss.unenhanced, tau=tau)
        enhancers = loss.enhancers if isinstance(loss, Enhancer) else []
        self.forks = [
            (fork, descent(fork.model_loss, fork.model_params, fork.model_lr))
            for fork in enhancers
            if isinstance(fork, Fork)
        ]
        self.lifeguards = [(guard, guard.make_optimizer()) for guard in enhancers if isinstance(guard, LifeGuard)]
        temperature = getattr(loss.unenhanced, "alpha_params", [])
        self.temperature = torch.optim.Adam(temperature, lr=temperature_lr) if temperature else None
        self.actor_learns = True
        self.updates = 0
        self._actor_loss = torch.zeros(())

    def step(self, trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates the networks on one batch and writes the new priorities into it.

        Returns:
            The detached losses and the mean value of the batch.
        """
        value = self.critic(sub_batch)
        sub_batch.set(self.loss.unenhanced.tensor_keys.priority, value.metadata["priority"])
        for fork, models in self.forks:
            fork.update_gate(**models(sub_batch).metadata)
        self.updates += 1
        if self.actor_learns and self.updates % self.policy_delay == 0:
            actor = self.actor(sub_batch)
            self._actor_loss = actor.loss
            if self.temperature is not None:
                self._step_temperature(actor.metadata["log_prob"])
            self.targets.step()
        return TensorDict(
            {
                "loss_value": value.loss,
                "loss_actor": self._actor_loss,
                "value": value.metadata["value"],
            }
        )

    def _value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The critics' loss, with the mean value and the priority (Eq. 2.17: the absolute error) beside it."""
        loss, metadata = self.loss.value_loss(batch)
        squared_error = metadata["td_error"]
        squared_error = squared_error.amax(0) if squared_error.ndim > 1 else squared_error
        return loss, {"priority": squared_error.sqrt(), "value": metadata["pred_value"].mean()}

    def _step_temperature(self, log_prob: Tensor) -> None:
        assert self.temperature is not None and isinstance(self.loss.unenhanced, SACLoss)
        self.temperature.zero_grad(set_to_none=True)
        self.loss.unenhanced.alpha_loss(log_prob).backward()
        self.temperature.step()

    def observe(self, episodes: TensorDictBase, sample: Callable[[int], TensorDictBase]) -> None:
        """Shows whole new episodes ``[T]`` to the enhancers, and trains LifeGuard for as many steps.

        Args:
            episodes: end to end, with every key that the environment emits.
            sample: gives n random stored transitions.
        """
        if not isinstance(self.loss, Enhancer):
            return
        self.loss.observe(episodes)
        for lifeguard, optimizer in self.lifeguards:
            lifeguard.fit(sample, len(episodes), optimizer)

    def diagnostics(self) -> dict[str, float]:
        """What the enhancers have to say of themselves."""
        return self.loss.diagnostics() if isinstance(self.loss, Enhancer) else {}

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        optimizers: dict[str, torch.optim.Optimizer | None] = {
            "actor_optimizer": self.actor.optimizer,
            "critic_optimizer": self.critic.optimizer,
            **{f"fork_optimizer_{i}": models.optimizer for i, (_, models) in enumerate(self.forks)},
            **{f"lifeguard_optimizer_{i}": optimizer for i, (_, optimizer) in enumerate(self.lifeguards)},
            "temperature_optimizer": self.temperature,
        }
        return {name: optimizer for name, optimizer in optimizers.items() if optimizer is not None}

    def state_dict(self) -> dict[str, Any]:
        """Optimisers and the update counter; the networks are the loss module's."""
        return {
            **{name: optimizer.state_dict() for name, optimizer in self._optimizers().items()},
            "updates": self.updates,
            "actor_loss": self._actor_loss,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        for name, optimizer in self._optimizers().items():
            optimizer.load_state_dict(state_dict[name])
        self.updates = state_dict["updates"]
        self._actor_loss = state_dict["actor_loss"].clone()
