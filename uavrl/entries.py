"""How the transforms and losses of the library read their entries."""

from collections.abc import Iterable

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from uavrl.errors import UavrlError


class MissingEntry(UavrlError, KeyError):
    """A part reads an entry that the data or the environment do not contain."""

    def __init__(
        self,
        reader: object,
        key: NestedKey,
        owner: str,
        found: Iterable[NestedKey],
        remedy: str = "name the right key in the constructor",
    ) -> None:
        name = reader if isinstance(reader, str) else type(reader).__name__
        super().__init__(
            f"{name} reads {key!r}, but {owner} only {sorted(map(str, found))}: {remedy}, "
            f"or rename your entry with TorchRL's RenameTransform."
        )

    __str__ = Exception.__str__  # KeyError would put the sentence into quotation marks


def after_step(key: NestedKey) -> NestedKey:
    """Return the key of an entry after a step: under ``"next"``, with which ``key`` may begin already.

    Examples:
        >>> after_step("arrived"), after_step(("next", "arrived")), after_step(("agent", "arrived"))
        (('next', 'arrived'), ('next', 'arrived'), ('next', 'agent', 'arrived'))
    """
    parts = (key,) if isinstance(key, str) else key
    return parts if parts[0] == "next" else ("next", *parts)


def entry(data: TensorDictBase, key: NestedKey, reader: object) -> Tensor:
    """Return an entry of ``data`` for ``reader``.

    Raises:
        MissingEntry: where there is none, naming the reader, the key and the keys that there are.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> entry(TensorDict(height=torch.ones(1)), "altitude", "NavigationObservation")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        uavrl.entries.MissingEntry: NavigationObservation reads 'altitude', but the data contain only ['height']: ...
    """
    value = data.get(key, None)
    if value is None:
        raise MissingEntry(reader, key, "the data contain", data.keys(True, True))
    return value


def entry_spec(spec: TensorSpec, key: NestedKey, reader: object) -> TensorSpec:
    """Return the spec of an entry that an environment emits for ``reader``.

    Raises:
        MissingEntry: where the environment does not emit it.
        UavrlError: where ``spec`` has no keys.
    """
    if not isinstance(spec, Composite):
        raise UavrlError(f"{type(reader).__name__} needs an environment whose specs are Composite, got {spec}.")
    known = spec.keys(True, True)
    if key not in known:
        raise MissingEntry(reader, key, "the environment emits", known)
    return spec[key]


def require_whole(done: Tensor, *, flat: bool = False) -> None:
    """Refuse steps whose last one does not end an episode.

    Args:
        done: ``[*B, T]``, true at the last step of each episode; a row may hold several episodes, end to end.
        flat: whether only ``[T]`` is accepted, with at least one step.

    Raises:
        UavrlError: for other steps, saying how to collect whole episodes.

    Examples:
        >>> import torch
        >>> require_whole(torch.tensor([False, True]))
        >>> require_whole(torch.zeros(60, dtype=torch.bool))  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        uavrl_onboard.errors.UavrlError: Expected whole episodes, got 60 steps, and the last one does not end ...
    """
    one_row, steps = done.ndim == 1, done.numel()
    if (one_row or (done.ndim and not flat)) and (bool(done[..., -1].all()) if steps else not flat):
        return
    count = f"{steps} steps" if one_row else f"steps {list(done.shape)}"
    reason = "the last one does not end an episode" if one_row or not flat else "they are not in one row [T]"
    raise UavrlError(
        f"Expected whole episodes, got {count}, and {reason}: collect with Collector(..., trajs_per_batch=1, "
        f"traj_format='cat'), or cut off the episode that has not ended."
    )
