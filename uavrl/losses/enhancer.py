"""How a term joins the actor's objective of any actor–critic loss, and how the models that it needs are trained."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import ReplayBuffer
from torchrl.objectives import LossModule
from torchrl.objectives.value import ValueEstimatorBase

from uavrl.losses.actor_critic import ActorCriticLoss

LossMethod = Callable[[TensorDictBase], tuple[Tensor, dict[str, Tensor]]]
Sample = Callable[[int], TensorDictBase]


def any_number(sample: Sample) -> Sample:
    """Return a function that draws n transitions; ``buffer.sample`` warns where n is not the buffer's batch size.

    Examples:
        >>> from torchrl.data import LazyTensorStorage
        >>> buffer = ReplayBuffer(storage=LazyTensorStorage(10), batch_size=4)
        >>> _ = buffer.extend(torch.arange(10))
        >>> any_number(buffer.sample)(7).shape
        torch.Size([7])
    """
    buffer = getattr(sample, "__self__", None)
    if not isinstance(buffer, ReplayBuffer) or buffer.batch_size is None or buffer.storage.ndim > 1:
        return sample
    return lambda count: buffer[torch.randint(len(buffer), (count,))]


@dataclass(frozen=True, kw_only=True)
class AuxiliaryModel:
    """A model that an actor penalty trains: at each update by ``loss``, after each episode by ``on_episode``, or both.

    Attributes:
        parameters: what Adam moves; none where ``on_episode`` has a rule of its own.
        lr: Adam's step.
        loss: returns the reduced loss of the critics' batch ``[B]``, and metadata.
        on_update: receives that metadata after each step.
        on_episode: trains after new episodes; takes a function that draws n stored transitions, the number of new
            steps, and Adam (None without parameters).
    """

    parameters: list[Tensor]
    lr: float
    loss: LossMethod | None = None
    on_update: Callable[[dict[str, Tensor]], None] = lambda metadata: None
    on_episode: Callable[[Sample, int, torch.optim.Optimizer | None], None] | None = None


class Enhancer(ActorCriticLoss, LossModule):
    """Adds a term to the actor's objective of another loss.

    A subclass defines :meth:`actor_term`; one with models to train defines :attr:`models`, too.

    They nest: ``LifeGuard(Fork(TD3Loss(...)))``. What one does not change comes from ``base``, whose
    networks appear as its own: ``loss.target_actor_network_params``, ``SoftUpdate(loss, tau=0.005)``.

    Args:
        base: the loss to add the term to, or another actor penalty.
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that :meth:`set_keys` renames, besides those of the base."""

        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys

    learns_from_single_steps: ClassVar[bool] = True
    """Whether its models need states that lie one step apart, so that n-step returns would mislead them."""

    relative: ClassVar[bool] = False
    """Whether the term counts as a share of the objective's mean absolute value, so that it stays while values grow."""

    reads_last_action: ClassVar[bool] = False
    """Whether its term needs states that end with the action that led to them."""

    def __init__(self, base: ActorCriticLoss) -> None:
        super().__init__()
        self.base = base
        self._has_update_associated = base._has_update_associated  # one updater serves both
        self.reduction = base.reduction
        self.use_prioritized_weights = base.use_prioritized_weights
        self.loss_mask_key = base.loss_mask_key
        self.out_keys = list(base.out_keys)
        for keys in (base.unwrapped.tensor_keys, base.tensor_keys):
            for name in self._AcceptedKeys.__dataclass_fields__:
                if hasattr(keys, name):
                    setattr(self.tensor_keys, name, getattr(keys, name))

    @abstractmethod
    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """What is added to the objective of each sample ``[*B]``, and detached metadata."""

    @property
    def active(self) -> bool:
        """Whether the term counts now; a recorded update holds as long as this does not change."""
        return True

    @property
    def models(self) -> list[AuxiliaryModel]:
        """The models that the term needs trained."""
        return []

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """The losses ``loss_*`` of the models, for :meth:`forward`."""
        return {}

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
        """Does nothing: the base has told its estimator."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's losses on transitions ``[*B]``, the enhanced ``loss_actor``, and the losses of the models."""
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

    @property
    def enhancers(self) -> list[ActorCriticLoss]:
        """This actor penalty and those below it, the outermost first."""
        return [self, *self.base.enhancers]

    @property
    def unwrapped(self) -> ActorCriticLoss:
        """The loss below all actor penalties."""
        return self.base.unwrapped

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return self.base.critic_network_params

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes whole new episodes ``[T]``, end to end, each of them once; so does the base."""
        self.base.observe(episodes)

    def diagnostics(self) -> dict[str, float]:
        """Numbers to log, the base's among them."""
        return self.base.diagnostics()

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's action."""
        return self.base.act(tensordict)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The base's value."""
        return self.base.action_value(acted, target=target)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's objective, and the term while it is active."""
        objective, metadata = self.base.actor_objective(acted, target=target)
        if not self.active:
            return objective, metadata
        term, own = self.actor_term(acted)
        scale = objective.detach().abs().mean() if self.relative else 1.0
        return objective + scale * term, metadata | own

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """The base's; the γ of FORK's predicted steps is an argument of FORK."""
        self.base.make_value_estimator(value_type, **hyperparams)
        return self

    @property
    def value_estimator(self) -> ValueEstimatorBase:
        """The base's."""
        return self.base.value_estimator

    def set_vmap_randomness(self, value: str) -> None:
        """The base's."""
        self.base.set_vmap_randomness(value)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's critic loss."""
        return self.base.value_loss(tensordict)
