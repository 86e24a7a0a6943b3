"""One optimisation step of an actor–critic."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.trainers import OptimizationStepper, Trainer

from uavrl.config.schedules import are_shares, is_interval
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss
from uavrl.losses.actor_penalty import Sample
from uavrl.training.compiled import Execution, FusedSoftUpdate, GradientStep
from uavrl_onboard.ranges import Positive, Rule, Share

Interval = Annotated[
    Sequence[float],
    Rule("two shares of the run, up to 1, or two whole numbers of updates, the first below the second", is_interval),
]
LAST_SHARE = 0.02


def decayed(lr: float, decay: Sequence[float] | None, updates: int) -> float:
    """A learning rate that falls linearly between two numbers of updates, to 2 % of what it was.

    Examples:
        >>> [round(decayed(1.0, (100, 200), updates), 3) for updates in (0, 100, 150, 199, 1000)]
        [1.0, 1.0, 0.5, 0.02, 0.02]
    """
    if decay is None:
        return lr
    start, end = decay
    return lr * min(1.0, max(LAST_SHARE, (end - updates) / (end - start)))


class ActorCriticStepper(OptimizationStepper):
    """Critics and models every step; actor and targets every ``policy_delay``, while ``actor_learns`` (Algorithm 3.1).

    Args:
        loss: gives ``value_loss(batch)`` and ``actor_loss(batch)``; its ``penalties`` say what else is trained.
        actor_lr: Adam's step for the actor.
        actor_lr_decay: updates between which it falls linearly to 2 % of that; None: it stays. Shares of a run, such as
            ``[0.5, 1.0]``, are numbers of updates in its configuration (:func:`uavrl.config.schedules.in_updates`).
        critic_lr: Adam's step for the critics.
        temperature_lr: Adam's step for SAC's temperature.
        policy_delay: critic steps for each step of actor and targets.
        tau: share of the online networks in each target update (Eq. 2.9), if the loss has targets.
        execution: as in :class:`~uavrl.training.compiled.LossGradients`.
    """

    updates_replay_priority = True

    def __init__(
        self,
        loss: ActorCriticLoss,
        *,
        actor_lr: Positive = 1e-4,
        actor_lr_decay: Interval | None = None,
        critic_lr: Positive = 1e-3,
        temperature_lr: Positive = 3e-4,
        policy_delay: Annotated[int, Field(ge=1, le=10**6)] = 2,
        tau: Share = 0.005,
        execution: Execution = "captured",
    ) -> None:
        super().__init__()
        self.loss = loss
        self.policy_delay = policy_delay
        if actor_lr_decay is not None and are_shares(actor_lr_decay):
            raise UavrlError(f"actor_lr_decay takes two numbers of updates here, got the shares {[*actor_lr_decay]}.")
        self.actor_lr, self.actor_lr_decay = actor_lr, actor_lr_decay
        keys = (loss.unwrapped.tensor_keys.priority_weight, loss.value_estimator.tensor_keys.steps_to_next_obs)
        in_keys = [*loss.in_keys, *keys]
        self.critic = GradientStep(self._value_loss, loss.critic_tensors, critic_lr, execution, in_keys)
        self.actor = GradientStep(loss.actor_loss, loss.actor_tensors, actor_lr, execution, in_keys, self._active)
        self.targets = (
            FusedSoftUpdate(loss.unwrapped, tau=tau) if getattr(loss.unwrapped, "has_targets", True) else None
        )
        self.tau = tau
        temperature = loss.unwrapped.alpha_params
        self.temperature = torch.optim.Adam(temperature, lr=temperature_lr) if temperature else None
        models = [model for penalty in loss.penalties for model in penalty.models]
        self.models = [
            (GradientStep(model.loss, model.parameters, model.lr, execution), model.on_update)
            for model in models
            if model.loss is not None
        ]
        adam = partial(torch.optim.Adam, fused=True)
        self.fits = [
            (model.on_episode, adam(model.parameters, lr=model.lr) if model.parameters else None)
            for model in models
            if model.on_episode is not None
        ]
        self.actor_learns = True
        self.updates = 0
        self._actor_loss = torch.zeros(())

    def step(self, trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch, which gets the new priorities; returns detached losses and the batch's mean value."""
        value = self.critic(sub_batch)
        self.loss.project_weights()
        if not self.loss.learns_from_sequences:  # in which a priority is that of no row
            sub_batch.set(self.loss.unwrapped.tensor_keys.priority, value.metadata["priority"])
        for model, on_update in self.models:
            on_update(model(sub_batch).metadata)
        self.updates += 1
        if self.actor_learns and self.updates % self.policy_delay == 0:
            for group in self.actor.optimizer.param_groups:
                group["lr"] = decayed(self.actor_lr, self.actor_lr_decay, self.updates)
            actor = self.actor(sub_batch)
            self._actor_loss = actor.loss
            if self.temperature is not None:
                self.temperature.zero_grad(set_to_none=True)
                self.loss.unwrapped.alpha_loss(actor.metadata["log_prob"]).backward()
                self.temperature.step()
            if self.targets is not None:
                self.targets.step()
            self.loss.move_memories(self.tau)
        return TensorDict({"loss_value": value.loss, "loss_actor": self._actor_loss, "value": value.metadata["value"]})

    def warm_up(self, batch: TensorDictBase) -> Tensor:
        """Updates critics and targets alone on one batch; returns the critics' loss. It counts as no update."""
        value = self.critic(batch)
        self.loss.project_weights()
        if self.targets is not None:
            self.targets.step()
        self.loss.move_memories(self.tau)
        return value.loss

    def _value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The critics' loss, with the mean value and the priority (Eq. 2.17: the absolute error) beside it."""
        loss, metadata = self.loss.value_loss(batch)
        squared_error = metadata["td_error"]
        squared_error = squared_error.amax(0) if squared_error.ndim > 1 else squared_error
        return loss, {"priority": squared_error.sqrt(), "value": metadata["pred_value"].mean()}

    def _active(self) -> tuple[bool, ...]:
        """Which terms the actor's loss has now: what its recording holds for."""
        return tuple(penalty.active for penalty in self.loss.penalties)

    def observe(self, episodes: TensorDictBase, sample: Sample) -> None:
        """Shows whole new episodes ``[T]`` to the actor penalties; trains the models that learn after each episode."""
        self.loss.observe(episodes)
        for on_episode, optimizer in self.fits:
            on_episode(sample, len(episodes), optimizer)

    def diagnostics(self) -> dict[str, float]:
        """What the actor penalties have to say of themselves."""
        return self.loss.diagnostics()

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        optimizers: dict[str, torch.optim.Optimizer | None] = {
            "actor_optimizer": self.actor.optimizer,
            "critic_optimizer": self.critic.optimizer,
            "temperature_optimizer": self.temperature,
            **{f"model_optimizer_{i}": model.optimizer for i, (model, _) in enumerate(self.models)},
            **{f"fit_optimizer_{i}": optimizer for i, (_, optimizer) in enumerate(self.fits)},
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
