"""The first phase of a run: the actor clones a demonstrator in the states that it reaches itself (DAgger)."""

from collections.abc import Iterator
from typing import Annotated, Any

import torch
from pydantic import Field
from tensordict import TensorDictBase, TensorDictParams
from torch import Tensor

from uavrl.buffers.sequences import WEIGHT
from uavrl.config.schedules import CLONING_STEPS
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss
from uavrl.losses.imitation import Imitation, action_distance, decayed
from uavrl.training.compiled import Execution, GradientStep
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION
from uavrl_onboard.ranges import Count, Positive

FLOWN_STATES = ("observation", DEMONSTRATOR_ACTION)


class Cloning:
    """Supervised learning of the actor on all states flown so far, each with the demonstrator's action there.

    The demonstrator flies the first ``algo.learning_starts`` steps of a run and the actor the others, so that it learns
    what to do where its own errors lead it. Updates are spread evenly over the steps: each new episode is followed by
    some, on batches of all episodes.

    Source: Ross, Gordon and Bagnell (2011), A Reduction of Imitation Learning and Structured Prediction to No-Regret
    Online Learning (DAgger), with rounds of one episode.

    Args:
        loss: gives the actor that is trained; critics, penalties and targets take no part.
        limit: the largest action.
        steps: environment steps that the phase lasts; None: 30,000 (a run's configuration makes it all of the run).
        updates_per_step: of Adam, for each environment step.
        batch_size: states in a batch.
        lr: Adam's learning rate at first.
        final_lr: what it has fallen to at the end, geometrically.
        critic_updates: of the critics alone, on all states flown so far, before the algorithm takes over.
        execution: as in :class:`~uavrl.training.compiled.LossGradients`. Nothing is compiled, which would take a good
            part of so short a phase: large batches spend their time in matrix products.

    Raises:
        UavrlError: for so few updates that there would be none.

    Examples:
        >>> from torchrl.data import Bounded
        >>> from uavrl.losses import TD3Loss
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from uavrl.models import Actor, Critic
        >>> critics = [Mod(Critic(6, 2), ["observation", "action"], ["state_action_value"]) for _ in range(2)]
        >>> actor = Mod(Actor(6, 2), ["observation"], ["action"])
        >>> cloning = Cloning(TD3Loss(actor, critics, action_spec=Bounded(-1, 1, (2,))), limit=1.0)
        >>> batch = TensorDict({"observation": torch.ones(5, 6), "demonstrator_action": torch.ones(5, 2)}, [5])
        >>> first = cloning.learn([batch] * 20, steps=0)
        >>> first > cloning.learn([batch], steps=0)
        True
    """

    def __init__(
        self,
        loss: ActorCriticLoss,
        limit: Positive,
        *,
        steps: Count | None = None,
        updates_per_step: Annotated[float, Field(gt=0, le=100)] = 0.4,
        batch_size: Count = 512,
        lr: Positive = 1e-3,
        final_lr: Positive = 1e-4,
        critic_updates: Annotated[int, Field(ge=0, le=10**6)] = 2000,
        execution: Execution = "captured",
    ) -> None:
        self.loss, self.limit, self.updates = loss, limit, 0
        self.steps = steps or CLONING_STEPS
        self.updates_per_step, self.batch_size = updates_per_step, batch_size
        self.lr, self.final_lr, self.critic_updates = lr, final_lr, critic_updates
        if self.due(self.steps) < 1:
            raise UavrlError(
                f"cloning.updates_per_step={updates_per_step:g} makes no update in {self.steps:,} steps, so nothing "
                "would be cloned: raise it, or cloning.steps."
            )
        recorded: Execution = "eager" if execution == "eager" else "captured"
        self.step = GradientStep(self._distance, loss.actor_tensors, lr, recorded, FLOWN_STATES)

    def _distance(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The mean distance of the actor's action to the demonstrator's, in states ``[B]`` or windows ``[B]``."""
        states = self.loss.states(batch)
        distance = action_distance(self.loss.act(states).get("action"), states.get(DEMONSTRATOR_ACTION), self.limit)
        if self.loss.learns_from_sequences:
            weight = states.get(WEIGHT)
            return (weight * distance).sum() / weight.sum(), {}
        return distance.mean(), {}

    @property
    def finished(self) -> bool:
        """Whether all updates were made."""
        return self.due(self.steps) <= 0

    def due(self, steps: int) -> int:
        """How many updates follow an episode that ended after so many steps of the run."""
        return int(min(steps, self.steps) * self.updates_per_step) - self.updates

    def learn(self, batches: Iterator[TensorDictBase] | list[TensorDictBase], steps: int) -> float | None:
        """One update on each batch of states ``[B]``; returns the mean loss, None without batches."""
        rate = decayed(self.lr, self.final_lr, steps / self.steps)
        for group in self.step.optimizer.param_groups:
            group["lr"] = rate
        keys = ("seen", "steps") if self.loss.learns_from_sequences else FLOWN_STATES
        losses = [self.step(batch.select(*keys)).loss for batch in batches]
        self.updates += len(losses)
        if self.finished:
            self._hand_over()
        return torch.stack(losses).mean().item() if losses else None

    def _hand_over(self) -> None:
        """Makes the target actor, if there is one, a copy of the actor; the weight of imitation begins its decay."""
        base = self.loss.unwrapped
        target = getattr(base, "target_actor_network_params", None)
        if isinstance(target, TensorDictParams):
            target.data.update_(base.actor_network_params.data)
        self.loss.move_memories(1.0)
        for penalty in self.loss.penalties:
            if isinstance(penalty, Imitation):
                penalty.restart()

    def state_dict(self) -> dict[str, Any]:
        """Adam and the number of updates; the actor is the loss module's."""
        return {"optimizer": self.step.optimizer.state_dict(), "updates": self.updates}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.step.optimizer.load_state_dict(state_dict["optimizer"])
        self.updates = state_dict["updates"]
