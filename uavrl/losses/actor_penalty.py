"""Actor penalties: terms in the actor's objective of any actor–critic loss, and the models that they train."""

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
    """Return a function that draws n transitions without the warning of ``buffer.sample`` about its batch size.

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
        parameters: the parameters that Adam updates; empty if ``on_episode`` updates the model without Adam.
        lr: learning rate of Adam.
        loss: returns the reduced loss of the critics' batch ``[B]``, and metadata.
        on_update: receives that metadata after each step.
        on_episode: trains the model after new episodes. Its arguments are a function that draws n stored transitions,
            the number of new steps, and Adam (None without parameters).
    """

    parameters: list[Tensor]
    lr: float
    loss: LossMethod | None = None
    on_update: Callable[[dict[str, Tensor]], None] = lambda metadata: None
    on_episode: Callable[[Sample, int, torch.optim.Optimizer | None], None] | None = None


def _shared(name: str) -> property:
    """Return a property that reads and sets the attribute of the base."""

    def put(self: ActorPenalty, value: Any) -> None:
        if "base" in self._modules:  # TorchRL's constructor sets some attributes before the base exists
            setattr(self.base, name, value)

    return property(lambda self: getattr(self.base, name), put)


class ActorPenalty(ActorCriticLoss, LossModule):
    """Adds a term to the actor's objective of another loss.

    A subclass defines :meth:`actor_term`; one with models to train defines :attr:`models`, too.

    The other loss is one of :mod:`uavrl.losses`, or a loss of TorchRL, or of your own, that has an actor and a critic
    of the actor's actions: ``TD3Loss``, ``DDPGLoss``, ``SACLoss``, ``REDQLoss``, ``CrossQLoss`` and their subclasses.
    Its actor loss stays as its class computes it, and the term is added.

    You can nest penalties: ``LifeGuard(Fork(TD3Loss(...)))``. A penalty passes on the networks, methods and settings of
    its ``base``: ``loss.target_actor_network_params``, ``SoftUpdate(loss, tau=0.005)``, ``loss.reduction = "sum"``.

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
    """True if its models need states that are one step apart, so that you cannot use n-step returns."""

    relative: ClassVar[bool] = False
    """True if the term is multiplied by the mean absolute value of the objective, so that both grow together."""

    reads_last_action: ClassVar[bool] = False
    """True if its term needs states that end with the last action."""

    computed: ClassVar[Mapping[str, str]] = {}
    """Attributes that you cannot set, with the names of the attributes that determine them."""

    reduction = _shared("reduction")
    use_prioritized_weights = _shared("use_prioritized_weights")
    loss_mask_key = _shared("loss_mask_key")
    deterministic_sampling_mode = _shared("deterministic_sampling_mode")
    vmap_randomness = _shared("vmap_randomness")
    value_type = _shared("value_type")
    value_estimator = _shared("value_estimator")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Record when an instance is complete; after that, setting an attribute that it does not have is an error."""
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
        self._has_update_associated = base._has_update_associated  # an updater of the penalty is one of the base
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
        """Refuse a penalty that replaces the objective of TorchRL's loss, which allows only added terms."""
        if type(self).actor_objective is not ActorPenalty.actor_objective:
            raise UavrlError(
                f"{type(self).__name__} replaces the actor's objective and needs a loss of uavrl.losses, got "
                f"{type(base).__module__}.{type(base).__name__}: use the class of the same name in uavrl.losses."
            )

    @abstractmethod
    def actor_term(self, acted: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the term to add to the objective of each sample ``[*B]``, and detached metadata."""

    @property
    def active(self) -> bool:
        """True if the term is added now. A recorded update stays valid until this changes."""
        return True

    @property
    def models(self) -> list[AuxiliaryModel]:
        """The models that are trained for the term."""
        return []

    def model_losses(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the losses ``loss_*`` of the models for :meth:`forward`."""
        return {}

    @property
    def in_keys(self) -> list[NestedKey]:
        """The keys that :meth:`forward` reads."""
        return self._inner.in_keys

    def _accepted_keys(self) -> set[str]:
        return super()._accepted_keys() | self._inner._accepted_keys()

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """Rename keys in this penalty and in its base, wherever they are known; None restores the default.

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
        """Do nothing, because the base has already passed its keys to its estimator."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the losses of base and models on transitions ``[*B]``; ``loss_actor`` includes the terms."""
        losses = self.unwrapped(tensordict)
        for penalty in reversed(self.penalties):  # the actor's term may depend on these losses
            losses.update(penalty.model_losses(tensordict))
        if isinstance(self.unwrapped, ActorCriticLoss):
            loss_actor, metadata = self.actor_loss(tensordict)
        else:
            loss_actor, metadata = self._with_terms(losses.get("loss_actor"), {}, tensordict)
        return losses.update({"loss_actor": loss_actor, **metadata})

    def named_children(self) -> Iterator[tuple[str, nn.Module]]:
        """Iterate over its modules and the target networks of the base, which TorchRL's updaters look for here."""
        yield from super().named_children()
        yield from (pair for pair in self.base.named_children() if pair[0].startswith("target_"))

    def children(self) -> Iterator[nn.Module]:
        """Iterate over its modules."""
        return (module for _, module in super().named_children())

    def __getattr__(self, name: str) -> Any:
        """Return a public attribute of the base, such as a network or its parameters, if the penalty has none."""
        modules = self.__dict__.get("_modules", {})
        if "base" not in modules or name.startswith("_"):
            return super().__getattr__(name)
        if "_network" not in name and "_is_complete" not in self.__dict__:  # its constructor tests what exists
            return super().__getattr__(name)
        if name.removeprefix("target_") in modules or _holds(self, name):
            return super().__getattr__(name)
        return getattr(modules["base"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute of the penalty or of its base; once the penalty is complete, refuse any other."""
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
        """Also load the target entropy, which becomes a buffer of TorchRL's losses when it is first used."""
        if any(key.startswith(prefix) and "target_entropy" in key for key in state_dict):
            getattr(self.unwrapped, "target_entropy", None)
        super()._load_from_state_dict(state_dict, prefix, *args)

    def _refresh(self) -> None:
        """Recompute the values that depend on the settings and on the observed episodes."""

    def _cannot_set(self, name: str) -> str:
        kind = type(self).__name__
        if name in signature(type(self)).parameters:
            return f"{kind} takes {name} only when it is made: make a new one with {name}=…."
        close = get_close_matches(name, [key for key in dir(self) if not key.startswith("_")], n=1)
        meant = f": did you mean {close[0]}?" if close else "."
        return f"Neither {kind} nor the loss below has an attribute {name!r} to set{meant}"

    def reset_parameters_recursive(self) -> None:
        """Draw new weights for all networks of the base and the penalty; observed episodes stay."""
        self.base.reset_parameters_recursive()
        super().reset_parameters_recursive()

    @property
    def _inner(self) -> ActorCriticLoss | TorchRLLoss:
        """The base with the methods of :class:`ActorCriticLoss`."""
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
        """The parameters that the critics' optimiser updates, as TorchRL stores them."""
        return self._inner.critic_network_params

    @property
    def critic_tensors(self) -> list[Tensor]:
        """The parameters that the critics' optimiser updates, and the buffers that their loss may change."""
        return self._inner.critic_tensors

    @property
    def alpha_params(self) -> list[Tensor]:
        """The parameters that :meth:`alpha_loss` of the base trains."""
        return self._inner.alpha_params

    def alpha_loss(self, *args: Any, **kwargs: Any) -> Tensor:
        """Return the base's loss of the temperature."""
        return self.base.alpha_loss(*args, **kwargs)

    def observe(self, episodes: TensorDictBase) -> None:
        """Pass new whole episodes ``[T]``, one after the other, to the base; each episode comes once."""
        self._inner.observe(episodes)

    def diagnostics(self) -> dict[str, float]:
        """Return numbers to log, including those of the base."""
        return self._inner.diagnostics()

    def project_weights(self) -> None:
        """Scale each row of the unit-norm layers of the base's critics back to norm 1."""
        self._inner.project_weights()

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the states with the base's actions."""
        return self._inner.act(tensordict)

    def action_value(self, acted: TensorDictBase, *, target: bool = False) -> Tensor:
        """Return the base's value."""
        return self._inner.action_value(acted, target=target)

    def actor_objective(self, acted: TensorDictBase, *, target: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the base's objective plus the term if it is active, and metadata."""
        objective, metadata = self.base.actor_objective(acted, target=target)
        if not self.active:
            return objective, metadata
        term, own = self._scaled_term(acted, objective)
        return objective + term, metadata | own

    def _scaled_term(self, acted: TensorDictBase, objective: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the term ``[*B]``, scaled by the objective ``[*B]`` if it is relative, and metadata."""
        term, metadata = self.actor_term(acted)
        return (objective.detach().abs().mean() * term if self.relative else term), metadata

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the actor's reduced loss on states ``[*B]`` with the active terms, and detached metadata."""
        if isinstance(self.unwrapped, ActorCriticLoss):
            return super().actor_loss(tensordict)
        return self._with_terms(*TorchRLLoss(self.unwrapped).actor_loss(tensordict), tensordict)

    def loss_actor(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return :meth:`actor_loss`, under its name in TorchRL's ``DDPGLoss``."""
        return self.actor_loss(tensordict)

    def _with_terms(
        self, loss: Tensor, metadata: dict[str, Tensor], tensordict: TensorDictBase
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the reduced actor loss of TorchRL's class plus the active terms of all penalties, and metadata."""
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
        """Make the base's value estimator; the γ of FORK's predicted steps is an argument of FORK."""
        self.base.make_value_estimator(value_type, **hyperparams)
        return self

    def set_vmap_randomness(self, value: str) -> None:
        """Set the randomness of the base's vmap."""
        self.base.set_vmap_randomness(value)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critics' loss of the base, if its class has a method of this name."""
        return self.base.value_loss(tensordict)


def _holds(module: nn.Module, name: str) -> bool:
    """Return whether the instance itself has an attribute, parameter, buffer or module of that name."""
    state = module.__dict__
    return name in state or any(name in state.get(kind, {}) for kind in ("_parameters", "_buffers", "_modules"))
