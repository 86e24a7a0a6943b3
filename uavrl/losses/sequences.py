"""An actor–critic loss whose actor and critics have a memory each, on windows of whole episodes."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase, TensorDictParams
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.models.memory import CRITIC_MEMORY, MEMORY, GRUMemory, frozen_copy, taken_at
from uavrl.upstream import lerp


class SequenceLoss(ActorCriticLoss, nn.Module):
    """Fills the memories over each window, and hands the transitions, with what is remembered, to another loss.

    That loss may have actor penalties around it. Its actor reads ``memory`` and ``observation``, its critics
    ``critic_memory`` and ``observation``. The memory that a target reads has a target of its own.

    Args:
        loss: of the networks behind the memories, :class:`~uavrl.losses.TD3Loss` or :class:`~uavrl.losses.SACLoss`.
        actor_memory: of the policy.
        critic_memory: that all critics share.

    Raises:
        UavrlError: for another loss, such as TorchRL's own.

    Examples:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule as Mod
        >>> from torchrl.data import Bounded
        >>> from uavrl.losses import TD3Loss
        >>> from uavrl.models import Actor, Critic
        >>> keys = ["critic_memory", "observation", "action"]
        >>> critics = [Mod(Critic(8 + 3, 2), keys, ["state_action_value"]) for _ in range(2)]
        >>> actor = Mod(Actor(8 + 3, 2), ["memory", "observation"], ["action"])
        >>> base = TD3Loss(actor, critics, action_spec=Bounded(-1, 1, (2,)))
        >>> loss = SequenceLoss(base, GRUMemory(3, 8), GRUMemory(3, 8))
        >>> steps = TensorDict({"observation": torch.zeros(4, 2, 3), "now": torch.tensor([[5, 6]] * 4)}, [4, 2])
        >>> loss.actor_loss(TensorDict({"seen": torch.zeros(4, 8, 3), "steps": steps}, [4]))[0].shape
        torch.Size([])
    """

    learns_from_sequences: ClassVar[bool] = True

    def __init__(self, loss: ActorCriticLoss, actor_memory: GRUMemory, critic_memory: GRUMemory) -> None:
        if not isinstance(loss, ActorCriticLoss):
            raise UavrlError(
                f"SequenceLoss takes uavrl's TD3Loss or SACLoss, or an actor penalty around one, got a "
                f"{type(loss).__module__.partition('.')[0]}.{type(loss).__name__}."
            )
        nn.Module.__init__(self)
        self.loss, self.actor_memory, self.critic_memory = loss, actor_memory, critic_memory
        self.target_critic_memory = frozen_copy(critic_memory)
        delayed = getattr(loss.unwrapped, "delay_actor", False)
        self.target_actor_memory = frozen_copy(actor_memory) if delayed else None

    @property
    def in_keys(self) -> list[Any]:
        """What the networks behind the memories read."""
        return self.loss.in_keys

    @property
    def unwrapped(self) -> ActorCriticLoss:
        """The loss of the networks behind the memories, below all actor penalties."""
        return self.loss.unwrapped

    @property
    def penalties(self) -> list[ActorCriticLoss]:
        """The actor penalties of that loss."""
        return self.loss.penalties

    @property
    def value_estimator(self) -> Any:
        """That of the loss."""
        return self.loss.value_estimator

    @property
    def actor_network_params(self) -> TensorDictParams:
        """The parameters of the actor behind its memory."""
        return self.loss.actor_network_params

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters of the critics behind their memory."""
        return self.loss.critic_network_params

    @property
    def actor_tensors(self) -> list[Tensor]:
        """The parameters and buffers of the actor, and the parameters of its memory."""
        return [*self.loss.actor_tensors, *self.actor_memory.parameters()]

    @property
    def critic_tensors(self) -> list[Tensor]:
        """The parameters and buffers of the critics, and the parameters of their memory."""
        return [*self.loss.critic_tensors, *self.critic_memory.parameters()]

    def observe(self, episodes: TensorDictBase) -> None:
        """Show whole new episodes ``[T]`` to the actor penalties."""
        self.loss.observe(episodes)

    def diagnostics(self) -> dict[str, float]:
        """Return the numbers that the actor penalties log."""
        return self.loss.diagnostics()

    def project_weights(self) -> None:
        """Scale each row of the critics' unit-norm layers back to norm 1."""
        self.loss.project_weights()

    def states(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the transitions of windows ``[B]``, ``[B * T]``, with what the actor remembers in each."""
        taken = batch["steps"].flatten()
        return taken.set(MEMORY, taken_at(self.actor_memory.unroll(batch["seen"]), batch["steps", "now"]))

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return :meth:`states` with the current actor's actions, differentiable in the actor."""
        return self.loss.act(tensordict)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critics' reduced loss on windows ``[B]``, and metadata."""
        seen, steps = tensordict["seen"], tensordict["steps"]
        now, then, taken = steps["now"], steps["then"], steps.flatten()
        acting = self.actor_memory if self.target_actor_memory is None else self.target_actor_memory
        with torch.no_grad():
            taken.set(("next", MEMORY), taken_at(acting.unroll(seen), then))
            taken.set(("next", CRITIC_MEMORY), taken_at(self.target_critic_memory.unroll(seen), then))
        taken.set(CRITIC_MEMORY, taken_at(self.critic_memory.unroll(seen), now))
        return self.loss.value_loss(taken)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the actor's reduced loss on windows ``[B]`` with all active terms, and metadata."""
        taken = self.states(tensordict)
        with torch.no_grad():
            remembered = taken_at(self.critic_memory.unroll(tensordict["seen"]), tensordict["steps", "now"])
        loss, metadata = self.loss.actor_loss(taken.set(CRITIC_MEMORY, remembered))
        if (log_prob := metadata.get("log_prob")) is not None:  # from which SAC's temperature learns
            weight = taken.get(self.unwrapped.tensor_keys.priority_weight)
            metadata = {**metadata, "log_prob": (weight * log_prob).sum() / weight.sum()}
        return loss, metadata

    @torch.no_grad()
    def move_memories(self, tau: float) -> None:
        """Move the targets of the memories by this share towards them."""
        pairs = [(self.critic_memory, self.target_critic_memory)]
        if self.target_actor_memory is not None:
            pairs.append((self.actor_memory, self.target_actor_memory))
        for online, target in pairs:
            lerp(list(target.parameters()), list(online.parameters()), tau)
