"""What a policy offers to the code that rolls it out, guards it or lets it demonstrate."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from uavrl_onboard.guards.settings import GuardSettings

Acts = Callable[[TensorDictBase], TensorDictBase]
"""The simplest policy, a callable that reads an environment's output and writes ``action``."""


@runtime_checkable
class TensorDictPolicy(Protocol):
    """A policy of an environment; :func:`as_policy` makes one of anything that acts.

    Attributes:
        in_keys: the entries that it reads; empty if it does not say.
        out_keys: the entries that it writes.
        has_map: whether it plans on a map of its own, and so needs the heading to the goal itself.
        overrides: the keys of a configuration that it was made for, with their values; None: it was made for none.
        guards: the guards that it flies with by default.
        recurrent_state: the shape of what it carries from step to step; None for a policy without a memory.
    """

    @property
    def in_keys(self) -> Sequence[NestedKey]: ...  # noqa: D102

    @property
    def out_keys(self) -> Sequence[NestedKey]: ...  # noqa: D102

    @property
    def has_map(self) -> bool: ...  # noqa: D102

    @property
    def overrides(self) -> Mapping[str, Any] | None: ...  # noqa: D102

    @property
    def guards(self) -> GuardSettings: ...  # noqa: D102

    @property
    def recurrent_state(self) -> tuple[int, ...] | None: ...  # noqa: D102

    def flown(self, actions: np.ndarray) -> None:
        """Take the actions ``[N, 4]`` that the vehicles fly instead of those that it wrote."""

    def __call__(self, tensordict: TensorDictBase, /) -> TensorDictBase:
        """Write ``action``."""


class PolicyModule(TensorDictModuleBase):
    """A module that is a :class:`TensorDictPolicy`; a subclass sets ``in_keys`` and ``out_keys``."""

    has_map: bool = False
    overrides: Mapping[str, Any] | None = None
    guards: GuardSettings = GuardSettings()
    recurrent_state: tuple[int, ...] | None = None

    def flown(self, actions: np.ndarray) -> None:
        """Take the actions that the vehicles fly; a policy that does not remember its own ignores them."""


class AdaptedPolicy:
    """A callable, with a default for each attribute that it does not have; ``act`` is the callable itself."""

    def __init__(self, act: Acts) -> None:
        self.act = act
        self.in_keys: Sequence[NestedKey] = list(getattr(act, "in_keys", ()))
        self.out_keys: Sequence[NestedKey] = list(getattr(act, "out_keys", ("action",)))
        self.has_map: bool = getattr(act, "has_map", False)
        self.overrides: Mapping[str, Any] | None = getattr(act, "overrides", None)
        self.guards: GuardSettings = getattr(act, "guards", GuardSettings())
        self.recurrent_state: tuple[int, ...] | None = getattr(act, "recurrent_state", None)
        self.flown: Callable[[np.ndarray], None] = getattr(act, "flown", lambda actions: None)

    def __call__(self, tensordict: TensorDictBase, /) -> TensorDictBase:
        """Act."""
        return self.act(tensordict)


def as_policy(act: Acts) -> TensorDictPolicy:
    """Return a policy that acts as this callable; what the callable does not offer has its default.

    Examples:
        >>> policy = as_policy(lambda tensordict: tensordict)
        >>> policy.in_keys, policy.out_keys, policy.has_map, policy.overrides
        ([], ['action'], False, None)
        >>> as_policy(policy) is policy
        True
    """
    return act if isinstance(act, TensorDictPolicy) else AdaptedPolicy(act)
