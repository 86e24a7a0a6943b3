"""What actor–critic losses have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
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
    _LossModule = ABC


class ActorCriticLoss(_LossModule):
    """The interface of a deterministic or reparameterised actor–critic loss.

    A subclass says how it acts and what it wants of an action; the actor's loss follows. An
    :class:`~uavrl.losses.Enhancer` reads the same three methods, so that it attaches to any of them.
    """

    actor_network_params: TensorDictParams

    out_keys = TensorDictModuleBase.out_keys  # TorchRL's lists hold for all instances: no key could be selected
    """What ``forward`` writes."""

    num_critics: ClassVar[int] = 2
    """How many critics :meth:`of_networks` takes."""

    @classmethod
    def policy_of(cls, network: nn.Module, action_spec: Bounded) -> TensorDictModuleBase:
        """The policy that this loss trains, of a network that takes states to actions.

        Args:
            network: ``observation [*B, S]`` to what the policy is made of: here, the action.
            action_spec: the bounds of one action.
        """
        return TensorDictModule(network, in_keys=["observation"], out_keys=["action"])

    @classmethod
    def of_networks(
        cls, actor: TensorDictModuleBase, critics: Sequence[TensorDictModule], action_spec: Bounded, **options: Any
    ) -> Self:
        """The loss of a policy and :attr:`num_critics` critics; a constructor that takes them otherwise says so here.

        Args:
            actor: what :meth:`policy_of` gave.
            critics: each reads ``observation`` and ``action``, writes ``state_action_value``.
            action_spec: the bounds of one action.
            **options: of the constructor.
        """
        return cls(actor, critics, action_spec=action_spec, **options)

    @property
    def unwrapped(self) -> ActorCriticLoss:
        """The loss below all enhancers; here that is itself."""
        return self

    @property
    def enhancers(self) -> list[ActorCriticLoss]:
        """The enhancers around the loss, the outermost first; here there are none."""
        return []

    @property
    def alpha_params(self) -> list[Tensor]:
        """The parameters of a temperature, which :meth:`alpha_loss` moves after each step of the actor: here, none."""
        return []

    def alpha_loss(self, log_prob: Tensor) -> Tensor:
        """The temperature's reduced loss, of the ``log_prob [*B]`` in the metadata of ``actor_loss``."""
        raise NotImplementedError

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes in whole new episodes ``[T]``, end to end: only enhancers learn from them."""

    def diagnostics(self) -> dict[str, float]:
        """Numbers worth logging: here, none."""
        return {}

    def _accepted_keys(self) -> set[str]:
        """The names that :meth:`set_keys` takes."""
        return set(self._AcceptedKeys.__dataclass_fields__)

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """Chooses how the values of next states become the critics' targets.

        Args:
            value_type: as in :class:`torchrl.objectives.LossModule`, by default TD(0).
            **hyperparams: such as ``gamma``; what is not given has TorchRL's default, not that of the constructor.
        """
        super().make_value_estimator(value_type, **hyperparams)
        return self

    def reset_parameters_recursive(self) -> None:
        """Draws the weights of all networks anew, each by its modules' ``reset_parameters``; targets become copies.

        What is no weight of a network stays, such as SAC's temperature.
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
    @abstractmethod
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""

    @abstractmethod
    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The state, with the action that the current actor takes there, differentiable in the actor.

        Args:
            tensordict: ``[*B]`` with the actor's in-keys; it is not modified.
        """

    @abstractmethod
    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The value ``[*B]`` of states and actions; the critics are constant, the action is not.

        Args:
            acted: ``[*B]`` with the state and an action.
            target: ask the target critics.
        """

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """What the actor minimises for each sample, ``[*B]`` (Chansuparp (2022), Eq. 2.13: ``-Q(s, μ(s))``).

        Args:
            acted: ``[*B]`` with the state and the actor's action.
            target: ascend the target critics in place of the online ones.
        """
        value = self.action_value(acted, target=target)
        return -value, {"state_action_value_actor": value.detach()}

    if TYPE_CHECKING:  # TorchRL's losses bring it

        def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
            """The critics' loss, and metadata with ``td_error``, ``pred_value``."""
            raise NotImplementedError

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The actor's loss; critics and models are constant.

        Args:
            tensordict: ``[*B]`` with the state.

        Returns:
            The reduced loss and detached metadata.
        """
        weights = self._maybe_get_priority_weight(tensordict)
        objective, metadata = self.actor_objective(self.act(tensordict))
        return self._reduce_loss(objective, tensordict=tensordict, weights=weights), metadata
