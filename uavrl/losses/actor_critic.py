"""What actor–critic losses have in common, and how an enhancer attaches to one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import TensorDictModule, TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.objectives import LossModule
from torchrl.objectives.value import ValueEstimatorBase

from uavrl.losses.functional import deterministic_policy_objective

# At run time a mixin: TorchRL's metaclass gives every subclass of LossModule a forward of its own,
# which would hide that of the loss it is mixed into.
if TYPE_CHECKING:
    from torchrl.objectives import LossModule as _LossModule
else:
    _LossModule = ABC


class ActorCriticLoss(_LossModule):
    """The interface of a deterministic or reparameterised actor–critic loss.

    A subclass says how it acts and what it wants of an action; the actor's loss follows. An
    :class:`Enhancer` reads the same three methods, so that it attaches to any of them.
    """

    actor_network_params: TensorDictParams

    out_keys = TensorDictModuleBase.out_keys  # TorchRL's lists hold for all instances: no key could be selected
    """What :meth:`forward` writes."""

    actor_reads_target = False
    """Whether the actor ascends the target critics in place of the online ones."""

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
    def unenhanced(self) -> ActorCriticLoss:
        """The loss below all enhancers: here, itself."""
        return self

    @property
    def mode(self) -> tuple[Hashable, ...]:
        """Names the branches that the losses would take now: a recorded or compiled graph holds for one mode."""
        return ()

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

    def actor_objective(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """What the actor minimises for each sample, ``[*B]`` (Chansuparp (2022), Eq. 2.13: ``-Q(s, μ(s))``)."""
        value = self.action_value(acted, target=self.actor_reads_target)
        return deterministic_policy_objective(value), {"state_action_value_actor": value.detach()}

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


class Enhancer(ActorCriticLoss, LossModule):
    """Adds a term to the actor's objective of another loss, and trains the models that the term needs.

    Enhancers nest: ``LifeGuard(Fork(TD3Loss(...)))``. What an enhancer does not change it asks of ``base``, whose
    networks it shows as its own: ``loss.target_actor_network_params``, ``SoftUpdate(loss, tau=0.005)``.

    Args:
        base: the loss to enhance, or another enhancer.
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that :meth:`set_keys` renames, besides those of the base."""

        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys

    def __init__(self, base: ActorCriticLoss) -> None:
        super().__init__()
        self.base = base
        self._has_update_associated = base._has_update_associated  # one updater serves both
        self.reduction = base.reduction
        self.use_prioritized_weights = base.use_prioritized_weights
        self.loss_mask_key = base.loss_mask_key
        self.out_keys = list(base.out_keys)
        for keys in (base.unenhanced.tensor_keys, base.tensor_keys):
            for name in self._AcceptedKeys.__dataclass_fields__:
                if hasattr(keys, name):
                    setattr(self.tensor_keys, name, getattr(keys, name))

    # ------------------------------------------------------------------ what a subclass gives

    @abstractmethod
    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor | None, dict[str, Tensor]]:
        """What is added to the objective of each sample ``[*B]``, or None while it has nothing to say."""

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes in whole new episodes ``[T]``, end to end. Call it once for each episode flown."""
        if isinstance(self.base, Enhancer):
            self.base.observe(episodes)

    def diagnostics(self) -> dict[str, float]:
        """Numbers worth logging."""
        return self.base.diagnostics() if isinstance(self.base, Enhancer) else {}

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """The losses ``loss_*`` of the models that the term needs, for :meth:`forward`."""
        return {}

    # ------------------------------------------------------------------ what TorchRL asks of a loss

    @property
    def in_keys(self) -> list[NestedKey]:
        """What :meth:`forward` reads."""
        return self.base.in_keys

    def _accepted_keys(self) -> set[str]:
        return super()._accepted_keys() | self.base._accepted_keys()

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """Renames keys here and in the base, wherever they are known; None restores a default.

        Raises:
            ValueError: for a key that none of the losses knows.
        """
        accepted = self._accepted_keys()
        if unknown := set(kwargs) - accepted:
            raise ValueError(f"Expected keys out of {sorted(accepted)}, got {sorted(unknown)}.")
        inner, own = self.base._accepted_keys(), super()._accepted_keys()
        self.base.set_keys(**{name: key for name, key in kwargs.items() if name in inner})
        super().set_keys(**{name: key for name, key in kwargs.items() if name in own})

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        """The base has told its own."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's losses, the enhanced ``loss_actor``, and the losses of the models.

        Args:
            tensordict: ``[*B]`` transitions; the base writes its priority into them.
        """
        losses = self.base(tensordict)
        losses.update(self.model_losses(tensordict))  # first: the actor's term may depend on how good they are
        loss_actor, metadata = self.actor_loss(tensordict)
        return losses.update({"loss_actor": loss_actor, **metadata})

    def named_children(self) -> Iterator[tuple[str, nn.Module]]:
        """Its modules, and the base's target networks: TorchRL's updaters look for them here."""
        yield from super().named_children()
        yield from (pair for pair in self.base.named_children() if pair[0].startswith("target_"))

    def children(self) -> Iterator[nn.Module]:
        """Its modules."""
        return (module for _, module in super().named_children())

    def __getattr__(self, name: str) -> Any:
        """The base's networks and their parameters, where there is nothing of that name here."""
        modules = self.__dict__.get("_modules", {})
        if "_network" in name and name.removeprefix("target_") not in modules and "base" in modules:
            return getattr(modules["base"], name)
        return super().__getattr__(name)

    def reset_parameters_recursive(self) -> None:
        """Draws the weights of all networks anew, the base's and its own; what was observed stays."""
        self.base.reset_parameters_recursive()
        super().reset_parameters_recursive()

    # ------------------------------------------------------------------ what is asked of the base

    @property
    def mode(self) -> tuple[Hashable, ...]:
        """The base's branches; a term that branches adds its own."""
        return self.base.mode

    @property
    def enhancers(self) -> list[Enhancer]:
        """This enhancer and those below it, the outermost first."""
        return [self, *(self.base.enhancers if isinstance(self.base, Enhancer) else [])]

    @property
    def unenhanced(self) -> ActorCriticLoss:
        """The loss below all enhancers."""
        return self.base.unenhanced

    @property
    def actor_network_params(self) -> TensorDictParams:
        """The parameters that the actor's optimiser moves."""
        return self.base.actor_network_params

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return self.base.critic_network_params

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's action."""
        return self.base.act(tensordict)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The base's value."""
        return self.base.action_value(acted, target=target)

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """The base's; the γ of FORK's predicted steps is an argument of its own."""
        self.base.make_value_estimator(value_type, **hyperparams)
        return self

    @property
    def value_estimator(self) -> ValueEstimatorBase:
        """The base's."""
        return self.base.value_estimator

    def set_vmap_randomness(self, value: str) -> None:
        """The base's: what its critics do with random layers."""
        self.base.set_vmap_randomness(value)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's critic loss."""
        return self.base.value_loss(tensordict)

    def actor_objective(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's objective and the term."""
        objective, metadata = self.base.actor_objective(acted)
        term, own = self.actor_term(acted)
        return objective if term is None else objective + term, metadata | own
