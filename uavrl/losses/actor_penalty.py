"""How a term joins the actor's objective of any actor–critic loss, and how the models that it needs are trained."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from typing import Any, ClassVar, Self

import torch
from tensordict import TensorDictBase, TensorDictParams
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import ReplayBuffer
from torchrl.objectives import LossModule

from uavrl.errors import UavrlError
from uavrl.losses.actor_critic import ActorCriticLoss
from uavrl.losses.adapter import TorchRLLoss, action_key, adapted

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


def _shared(name: str) -> property:
    """An attribute that a loss and the penalties around it have in common: it is the loss's."""

    def put(self: ActorPenalty, value: Any) -> None:
        if "base" in self._modules:  # TorchRL's constructor sets some before there is a base
            setattr(self.base, name, value)

    return property(lambda self: getattr(self.base, name), put)


class ActorPenalty(ActorCriticLoss, LossModule):
    """Adds a term to the actor's objective of another loss.

    A subclass defines :meth:`actor_term`; one with models to train defines :attr:`models`, too.

    The other loss is one of :mod:`uavrl.losses`, or a loss of TorchRL, or of your own, that has an actor and a critic
    of the actor's actions: ``TD3Loss``, ``DDPGLoss``, ``SACLoss``, ``REDQLoss``, ``CrossQLoss`` and their subclasses.
    Its actor loss stays as its class computes it, and the term is added.

    They nest: ``LifeGuard(Fork(TD3Loss(...)))``. Networks, methods and settings that a penalty does not have are those
    of ``base``: ``loss.target_actor_network_params``, ``SoftUpdate(loss, tau=0.005)``, ``loss.reduction = "sum"``.

    Args:
        base: the loss to add the term to, or another actor penalty.

    Raises:
        UavrlError: for a loss without an actor and a critic of its actions.
        AttributeError: when an attribute is set that neither the penalty nor its base has.
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

    computed: ClassVar[Mapping[str, str]] = {}
    """The names of numbers that cannot be set, with the names of the numbers that determine them."""

    reduction = _shared("reduction")
    use_prioritized_weights = _shared("use_prioritized_weights")
    loss_mask_key = _shared("loss_mask_key")
    deterministic_sampling_mode = _shared("deterministic_sampling_mode")
    vmap_randomness = _shared("vmap_randomness")
    value_type = _shared("value_type")
    value_estimator = _shared("value_estimator")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Notes when an instance is complete: from then on, attributes that it does not have cannot be set."""
        super().__init_subclass__(**kwargs)
        if (construct := cls.__dict__.get("__init__")) is None:
            return

        @wraps(construct)
        def complete(self: ActorPenalty, *args: Any, **kwargs: Any) -> None:
            construct(self, *args, **kwargs)
            if type(self).__init__ is complete:
                self.__dict__["_is_complete"] = True

        cls.__init__ = complete  # type: ignore[method-assign]

    def __init__(self, base: LossModule) -> None:
        inner = adapted(base)
        if not isinstance(inner.unwrapped, ActorCriticLoss):
            self._refuse_other_objective(inner.unwrapped)
        super().__init__()
        self.base = base
        self._has_update_associated = base._has_update_associated  # one updater serves both
        self.out_keys = list(dict.fromkeys(base.out_keys))
        names = self._AcceptedKeys.__dataclass_fields__
        for keys in (inner.unwrapped.tensor_keys, base.tensor_keys):
            for name in names:
                if hasattr(keys, name):
                    setattr(self.tensor_keys, name, getattr(keys, name))
        states, action = inner.unwrapped.actor_network.in_keys, action_key(inner.unwrapped)
        if "observation" in names and len(states) == 1:
            self.tensor_keys.observation = states[0]
        if "action" in names and action is not None:
            self.tensor_keys.action = action

    def _refuse_other_objective(self, base: LossModule) -> None:
        """A loss of TorchRL computes its objective itself: it can be added to, and not be replaced."""
        if type(self).actor_objective is not ActorPenalty.actor_objective:
            raise UavrlError(
                f"{type(self).__name__} replaces the actor's objective and needs a loss of uavrl.losses, got "
                f"{type(base).__module__}.{type(base).__name__}: use the class of the same name in uavrl.losses."
            )

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
        return self._inner.in_keys

    def _accepted_keys(self) -> set[str]:
        return super()._accepted_keys() | self._inner._accepted_keys()

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """Renames keys here and in the base, wherever they are known; None restores a default.

        Raises:
            ValueError: for a key that none of the losses knows.
        """
        accepted = self._accepted_keys()
        if unknown := set(kwargs) - accepted:
            raise ValueError(f"Expected keys out of {sorted(accepted)}, got {sorted(unknown)}.")
        inner, own = self._inner._accepted_keys(), super()._accepted_keys()
        self.base.set_keys(**{name: key for name, key in kwargs.items() if name in inner})
        super().set_keys(**{name: key for name, key in kwargs.items() if name in own})

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        """Does nothing: the base has told its estimator."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The losses below on transitions ``[*B]``, with the terms in ``loss_actor``, and the losses of the models."""
        losses = self.unwrapped(tensordict)
        for penalty in reversed(self.penalties):  # first: the actor's term may depend on how good the models are
            losses.update(penalty.model_losses(tensordict))
        if isinstance(self.unwrapped, ActorCriticLoss):
            loss_actor, metadata = self.actor_loss(tensordict)
        else:
            loss_actor, metadata = self._with_terms(losses.get("loss_actor"), {}, tensordict)
        return losses.update({"loss_actor": loss_actor, **metadata})

    def named_children(self) -> Iterator[tuple[str, nn.Module]]:
        """Its modules, and the base's target networks: TorchRL's updaters look for them here."""
        yield from super().named_children()
        yield from (pair for pair in self.base.named_children() if pair[0].startswith("target_"))

    def children(self) -> Iterator[nn.Module]:
        """Its modules."""
        return (module for _, module in super().named_children())

    def __getattr__(self, name: str) -> Any:
        """The base's public attributes, its networks and their parameters among them, where there is none here."""
        modules = self.__dict__.get("_modules", {})
        if "base" not in modules or name.startswith("_"):
            return super().__getattr__(name)
        if "_network" not in name and "_is_complete" not in self.__dict__:  # its constructor asks what there is already
            return super().__getattr__(name)
        if name.removeprefix("target_") in modules or _holds(self, name):
            return super().__getattr__(name)
        return getattr(modules["base"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        """Sets what the penalty has, or what its base has; nothing else, once the penalty is complete."""
        if name.startswith("_") or "_is_complete" not in self.__dict__:
            super().__setattr__(name, value)
        elif name in self.computed and not isinstance(value, Tensor):
            raise AttributeError(f"{type(self).__name__}.{name} is computed from {self.computed[name]}: set those.")
        elif _holds(self, name) or hasattr(type(self), name):
            super().__setattr__(name, value)
            if name != "training":
                self._refresh()
        elif hasattr(self.base, name):
            setattr(self.base, name, value)
        else:
            raise AttributeError(self._cannot_set(name))

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        """Also loads the target entropy, which TorchRL's losses make a buffer when it is first used."""
        if any(key.startswith(prefix) and "target_entropy" in key for key in state_dict):
            getattr(self.unwrapped, "target_entropy", None)
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _refresh(self) -> None:
        """Computes anew what follows from the settings and from what was observed."""

    def _cannot_set(self, name: str) -> str:
        kind = type(self).__name__
        if name in signature(type(self)).parameters:
            return f"{kind} takes {name} only when it is made: make a new one with {name}=…."
        close = get_close_matches(name, [key for key in dir(self) if not key.startswith("_")], n=1)
        meant = f": did you mean {close[0]}?" if close else "."
        return f"Neither {kind} nor the loss below has an attribute {name!r} to set{meant}"

    def reset_parameters_recursive(self) -> None:
        """Draws the weights of all networks anew, the base's and its own; what was observed stays."""
        self.base.reset_parameters_recursive()
        super().reset_parameters_recursive()

    @property
    def _inner(self) -> ActorCriticLoss | TorchRLLoss:
        """The base, with the methods that are called here."""
        return adapted(self.base)

    @property
    def penalties(self) -> list[ActorCriticLoss]:
        """This actor penalty and those below it, the outermost first."""
        return [self, *self._inner.penalties]

    @property
    def unwrapped(self) -> Any:
        """The loss below all actor penalties, of uavrl or TorchRL."""
        return self._inner.unwrapped

    @property
    def critic_network_params(self) -> TensorDictParams:
        """The parameters that the critic's optimiser moves."""
        return self._inner.critic_network_params

    @property
    def alpha_params(self) -> list[Tensor]:
        """The base's."""
        return self._inner.alpha_params

    def alpha_loss(self, *args: Any, **kwargs: Any) -> Tensor:
        """The base's."""
        return self.base.alpha_loss(*args, **kwargs)

    def observe(self, episodes: TensorDictBase) -> None:
        """Takes whole new episodes ``[T]``, end to end, each of them once; so does the base."""
        self._inner.observe(episodes)

    def diagnostics(self) -> dict[str, float]:
        """Numbers to log, the base's among them."""
        return self._inner.diagnostics()

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The base's action."""
        return self._inner.act(tensordict)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """The base's value."""
        return self._inner.action_value(acted, target=target)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's objective, and the term while it is active."""
        objective, metadata = self.base.actor_objective(acted, target=target)
        if not self.active:
            return objective, metadata
        term, own = self._scaled_term(acted, objective)
        return objective + term, metadata | own

    def _scaled_term(self, acted: TensorDictBase, objective: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The term ``[*B]``, as a share of the objective ``[*B]`` where it is relative, and metadata."""
        term, metadata = self.actor_term(acted)
        return (objective.detach().abs().mean() * term if self.relative else term), metadata

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The actor's reduced loss on states ``[*B]`` with the active terms, and detached metadata."""
        if isinstance(self.unwrapped, ActorCriticLoss):
            return super().actor_loss(tensordict)
        return self._with_terms(*TorchRLLoss(self.unwrapped).actor_loss(tensordict), tensordict)

    def loss_actor(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The name that TorchRL's ``DDPGLoss`` has for :meth:`actor_loss`."""
        return self.actor_loss(tensordict)

    def _with_terms(
        self, loss: Tensor, metadata: dict[str, Tensor], tensordict: TensorDictBase
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The reduced actor loss of TorchRL's class, with the active terms of all penalties around it, and metadata."""
        active = [penalty for penalty in reversed(self.penalties) if penalty.active]
        if not active:
            return loss, metadata
        root, acted = TorchRLLoss(self.unwrapped), self.act(tensordict)
        needs_scale = any(penalty.relative for penalty in active)
        objective = root.actor_objective(acted) if needs_scale else torch.zeros(acted.batch_size, device=loss.device)
        total = torch.zeros_like(objective)
        for penalty in active:
            term, own = penalty._scaled_term(acted, objective + total)
            total, metadata = total + term, metadata | own
        return loss + root.reduced(total, tensordict), metadata

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """The base's; the γ of FORK's predicted steps is an argument of FORK."""
        self.base.make_value_estimator(value_type, **hyperparams)
        return self

    def set_vmap_randomness(self, value: str) -> None:
        """The base's."""
        self.base.set_vmap_randomness(value)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The base's method of this name: the critic's loss, where its class calls it so."""
        return self.base.value_loss(tensordict)


def _holds(module: nn.Module, name: str) -> bool:
    """Whether the instance itself has an attribute, parameter, buffer or module of that name."""
    state = module.__dict__
    return name in state or any(name in state.get(kind, {}) for kind in ("_parameters", "_buffers", "_modules"))
