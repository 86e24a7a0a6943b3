"""The interface that all actor–critic losses share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded

from uavrl.losses.critics import project_weights

# At run time the class is a plain mixin. TorchRL's metaclass gives every subclass of LossModule its own forward, which
# would hide the forward of the loss that it is mixed into.
if TYPE_CHECKING:
    from torchrl.objectives import LossModule as _LossModule
else:
    _LossModule = object


class ActorCriticLoss(_LossModule):
    """The interface of a deterministic or reparameterised actor–critic loss.

    The actor's loss is computed by :meth:`act` and :meth:`action_value`. This class implements them for a deterministic
    actor and its first critic. An :class:`~uavrl.losses.ActorPenalty` calls the same methods, so you can attach it to
    any of these losses. ``uavrl.losses.adapter`` adds the methods to TorchRL's own losses.
    """

    actor_network_params: TensorDictParams

    out_keys = TensorDictModuleBase.out_keys  # TorchRL's lists hold for all instances: no key could be selected
    """The keys that ``forward`` writes."""

    critic_name: ClassVar[str] = "qvalue_network"
    """The name of the critics in TorchRL's loss."""

    num_critics: ClassVar[int] = 2
    """The number of critics that :meth:`of_networks` takes."""

    critics_may_differ: ClassVar[bool] = False
    """True if the critics may have inputs that the actor does not have, such as a memory of their own."""

    has_targets: ClassVar[bool] = True
    """True if target networks follow the others."""

    learns_from_sequences: ClassVar[bool] = False
    """True if batches contain windows of episodes instead of transitions, as in :class:`~uavrl.losses.SequenceLoss`."""

    @classmethod
    def policy_of(
        cls, network: nn.Module, action_spec: Bounded, in_keys: Sequence[str] = ("observation",)
    ) -> TensorDictModuleBase:
        """Return the policy of a network whose inputs are the ``in_keys``, ``[*B, S]``; here its output is the action.

        In a subclass with a stochastic actor, the output is the parameters of the action's distribution.
        """
        return TensorDictModule(network, in_keys=list(in_keys), out_keys=["action"])

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """Return the loss of a policy and :attr:`num_critics` critics; override it if your constructor differs.

        Args:
            actor: the policy that :meth:`policy_of` returned.
            critics: modules that read ``observation`` and ``action`` and write ``state_action_value``.
            action_spec: the bounds of one action.
            **options: arguments of the constructor.
        """
        return cls(actor, critics, action_spec=action_spec, **options)

    @property
    def unwrapped(self) -> ActorCriticLoss:
        """The loss below all actor penalties; here the loss itself."""
        return self

    @property
    def penalties(self) -> list[ActorCriticLoss]:
        """The actor penalties around the loss, the outermost first; here none."""
        return []

    @property
    def alpha_params(self) -> list[Tensor]:
        """The parameters that :meth:`alpha_loss` trains after each step of the actor; here none."""
        return []

    def alpha_loss(self, log_prob: Tensor) -> Tensor:
        """Return the reduced loss of the temperature, from ``log_prob [*B]`` in the metadata of ``actor_loss``."""
        raise NotImplementedError

    def observe(self, episodes: TensorDictBase) -> None:
        """Take new whole episodes ``[T]``, one after the other; only actor penalties learn from them."""

    def diagnostics(self) -> dict[str, float]:
        """Return numbers to log; here none."""
        return {}

    def _accepted_keys(self) -> set[str]:
        """Return the names that :meth:`set_keys` accepts."""
        return set(self._AcceptedKeys.__dataclass_fields__)

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """Make the value estimator as :class:`torchrl.objectives.LossModule` does, and return the loss.

        If you leave out an argument such as ``gamma``, it has TorchRL's default, not that of this constructor.
        """
        super().make_value_estimator(value_type, **hyperparams)
        return self

    def reset_parameters_recursive(self) -> None:
        """Draw new weights for all networks with ``reset_parameters``.

        Target networks become copies of the new networks. A temperature keeps its value.
        """
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
        """The parameters that the critics' optimiser updates, as TorchRL stores them."""
        return getattr(self, f"{self.critic_name}_params")

    @property
    def actor_tensors(self) -> list[Tensor]:
        """The parameters that the actor's optimiser updates, and the buffers that its loss may change."""
        return [value for value in self.actor_network_params.values(True, True) if isinstance(value, Tensor)]

    @property
    def critic_tensors(self) -> list[Tensor]:
        """The parameters that the critics' optimiser updates, and the buffers that their loss may change."""
        return [value for value in self.critic_network_params.values(True, True) if isinstance(value, Tensor)]

    def states(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the states ``[*B]`` of a batch in which :meth:`act` acts; here the batch itself."""
        return batch

    def project_weights(self) -> None:
        """Scale each row of the critics' unit-norm layers back to norm 1, after each step of their optimiser.

        It does nothing unless the critics have layers of :class:`~uavrl.models.UnitNormLinear`.
        """
        project_weights(getattr(self, self.critic_name), self.critic_network_params)

    def move_memories(self, tau: float) -> None:
        """Move the target memories towards the memories by this share; here there are no memories."""

    def _actor_inputs(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return a new tensordict with the inputs of the actor and the critics."""
        keys = (*self.actor_network.in_keys, *getattr(self, self.critic_name).in_keys)
        return tensordict.select(*keys, strict=False)

    def _constant_critics(self, target: bool) -> TensorDictBase:
        """Return the parameters of the critics or of their targets, without gradients."""
        return getattr(self, f"target_{self.critic_name}_params") if target else self.critic_network_params.detach()

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the states ``[*B]`` with the actions of the current actor; the input is not modified.

        The actions are differentiable with respect to the actor.
        """
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(self._actor_inputs(tensordict))

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """Return the value ``[*B]`` of states and actions by the critics or their targets, which get no gradients."""
        critic, params = getattr(self, self.critic_name), self._constant_critics(target)
        with (params[0] if params.batch_dims else params).to_module(critic, preserve_module_state=False):
            value = critic(acted.select(*critic.in_keys))
        return value.get(self.tensor_keys.state_action_value).squeeze(-1)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the objective that the actor minimises for each sample ``[*B]``, and metadata.

        It is ``-Q(s, μ(s))`` (Eq. 2.13).
        """
        value = self.action_value(acted, target=target)
        return -value, {"state_action_value_actor": value.detach()}

    if TYPE_CHECKING:  # TorchRL's losses implement it

        def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
            """Return the critics' reduced loss on transitions ``[*B]``, and ``td_error`` and ``pred_value``."""
            raise NotImplementedError

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the actor's reduced loss on states ``[*B]``, and detached metadata; only the actor gets gradients."""
        objective, metadata = self.actor_objective(self.act(tensordict))
        return self._reduced(objective, tensordict), metadata

    def _reduced(self, errors: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Reduce errors ``[*B]``, weighted by the priority weights of the batch if it has any."""
        return self._reduce_loss(errors, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
