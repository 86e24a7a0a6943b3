"""What actor–critic losses have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded

# At run time a mixin: TorchRL's metaclass gives every subclass of LossModule a forward of its own,
# which would hide that of the loss it is mixed into.
if TYPE_CHECKING:
    from torchrl.objectives import LossModule as _LossModule
else:
    _LossModule = object


class ActorCriticLoss(_LossModule):
    """The interface of a deterministic or reparameterised actor–critic loss.

    The actor's loss follows from :meth:`act` and :meth:`action_value`, which are here those of a deterministic actor
    and its first critic. An :class:`~uavrl.losses.ActorPenalty` calls the same methods, so that it attaches to any of
    them; TorchRL's own losses get them from ``uavrl.losses.adapter``.
    """

    actor_network_params: TensorDictParams

    out_keys = TensorDictModuleBase.out_keys  # TorchRL's lists hold for all instances: no key could be selected
    """What ``forward`` writes."""

    critic_name: ClassVar[str] = "qvalue_network"
    """What TorchRL's loss calls its critics."""

    num_critics: ClassVar[int] = 2
    """How many critics :meth:`of_networks` takes."""

    critics_may_differ: ClassVar[bool] = False
    """Whether critics may read what the actor does not, such as a memory of their own."""

    has_targets: ClassVar[bool] = True
    """Whether target networks follow the others."""

    learns_from_sequences: ClassVar[bool] = False
    """Whether batches hold windows of episodes, see :class:`~uavrl.losses.SequenceLoss`; else, transitions."""

    @classmethod
    def policy_of(
        cls, network: nn.Module, action_spec: Bounded, in_keys: Sequence[str] = ("observation",)
    ) -> TensorDictModuleBase:
        """The policy of a network that takes the ``in_keys``, ``[*B, S]``, to its parameters; here, to the action."""
        return TensorDictModule(network, in_keys=list(in_keys), out_keys=["action"])

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """The loss of a policy and :attr:`num_critics` critics; override it where the constructor differs.

        Args:
            actor: what :meth:`policy_of` returned.
            critics: each reads ``observation`` and ``action``, writes ``state_action_value``.
            action_spec: the bounds of one action.
            **options: arguments of the constructor.
        """
        return cls(actor, critics, action_spec=action_spec, **options)

    @property
    def unwrapped(self) -> ActorCriticLoss:
        """The loss below all actor penalties; here that is itself."""
        return self

    @property
    def penalties(self) -> list[ActorCriticLoss]:
        """The actor penalties around the loss, the outermost first; here there are none."""
        return []

    @property
    def alpha_params(self) -> list[Tensor]:
        """The parameters that :meth:`alpha_loss` trains after each step of the actor; here there are none."""
        return []

    def alpha_loss(self, log_prob: Tensor) -> Tensor:
        """The temperature's reduced loss, of the ``log_prob [*B]`` in the metadata of ``actor_loss``."""
        raise NotImplementedError

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes whole new episodes ``[T]``, end to end; only actor penalties learn from them."""

    def diagnostics(self) -> dict[str, float]:
        """Numbers to log; here there are none."""
        return {}

    def _accepted_keys(self) -> set[str]:
        """The names that :meth:`set_keys` takes."""
        return set(self._AcceptedKeys.__dataclass_fields__)

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """As in :class:`torchrl.objectives.LossModule`, and returns the loss.

        An argument such as ``gamma`` that is not given has TorchRL's default, not that of this loss's constructor.
        """
        super().make_value_estimator(value_type, **hyperparams)
        return self

    def reset_parameters_recursive(self) -> None:
        """Draws the weights of all networks anew by ``reset_parameters``; targets are copies, a temperature stays."""
        for name, network in self.__dict__.items():
            params = self._modules.get(f"{name}_params")
            if not isinstance(network, TensorDictModuleBase) or not isinstance(params, TensorDictParams):
                continue
            for one in params.data.unbind(0) if params.batch_dims else (params.data,):  # the critics are stacked
                with one.to_module(network, preserve_module_state=False):
                    network.reset_parameters_recursive()
            if isinstance(target := self._modules.get(f"target_{name}_params"), TensorDictParams):
                target.data.update_(params.data)

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return getattr(self, f"{self.critic_name}_params")

    @property
    def actor_parameters(self) -> list[Tensor]:
        """What the actor's optimiser moves."""
        return [value for value in self.actor_network_params.values(True, True) if isinstance(value, Tensor)]

    @property
    def critic_parameters(self) -> list[Tensor]:
        """What the critics' optimiser moves."""
        return [value for value in self.critic_network_params.values(True, True) if isinstance(value, Tensor)]

    def states(self, batch: TensorDictBase) -> TensorDictBase:
        """The states ``[*B]`` of a batch in which :meth:`act` acts; here they are the batch."""
        return batch

    def move_memories(self, tau: float) -> None:
        """Moves the targets of memories by this share; here there are none."""

    def _actor_inputs(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A new tensordict of what actor and critics read."""
        keys = (*self.actor_network.in_keys, *getattr(self, self.critic_name).in_keys)
        return tensordict.select(*keys, strict=False)

    def _constant_critics(self, target: bool) -> TensorDictBase:
        """The critics' parameters, or those of their targets, without gradients."""
        return getattr(self, f"target_{self.critic_name}_params") if target else self.critic_network_params.detach()

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """States ``[*B]`` with the current actor's actions, differentiable in the actor; the input is not modified."""
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(self._actor_inputs(tensordict))

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The value ``[*B]`` of states and actions by constant critics, or by the target critics."""
        critic, params = getattr(self, self.critic_name), self._constant_critics(target)
        with (params[0] if params.batch_dims else params).to_module(critic, preserve_module_state=False):
            value = critic(acted.select(*critic.in_keys))
        return value.get(self.tensor_keys.state_action_value).squeeze(-1)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """What the actor minimises for each sample ``[*B]``: ``-Q(s, μ(s))`` (Eq. 2.13), and metadata."""
        value = self.action_value(acted, target=target)
        return -value, {"state_action_value_actor": value.detach()}

    if TYPE_CHECKING:  # TorchRL's losses bring it

        def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
            """The critics' reduced loss on transitions ``[*B]``, and metadata with ``td_error`` and ``pred_value``."""
            raise NotImplementedError

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The actor's reduced loss on states ``[*B]``, and detached metadata; critics and models are constant."""
        objective, metadata = self.actor_objective(self.act(tensordict))
        return self._reduced(objective, tensordict), metadata

    def _reduced(self, errors: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Reduces errors ``[*B]``, weighted by the batch's priority weights if it has them."""
        return self._reduce_loss(errors, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
