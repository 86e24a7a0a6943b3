"""Several critics of one, several evaluated as one, and the mode that they are in."""

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn

from uavrl.errors import UavrlError
from uavrl.models.categorical import UnitNormLinear, unit_rows


def several(network: TensorDictModule | Sequence[TensorDictModule], count: int) -> list[TensorDictModule]:
    """Return ``count`` critics: those of a list, or one critic and copies of it with weights of their own.

    The copies draw their weights by ``reset_parameters``. TorchRL draws those of all critics from a uniform
    distribution between the smallest and the largest weight instead, which is wider than the network's own.

    Raises:
        ValueError: for a list of another length, or a network that cannot draw its weights again.

    Examples:
        >>> import torch
        >>> critic = TensorDictModule(nn.Linear(3, 1), ["observation"], ["state_action_value"])
        >>> first, second = several(critic, 2)
        >>> first is critic, torch.equal(first.module.weight, second.module.weight)
        (True, False)
    """
    if not isinstance(network, TensorDictModuleBase):
        if len(network) != count:
            raise ValueError(
                f"Expected a list of {count} critics, got {len(network)}: pass num_qvalue_nets={len(network)}, or one "
                "critic, of which copies are made."
            )
        return list(network)
    copies = [copy.deepcopy(network) for _ in range(count - 1)]
    for other in copies:
        other.reset_parameters_recursive()
        if all(one.equal(two) for one, two in zip(network.parameters(), other.parameters(), strict=True)):
            raise UavrlError(
                f"{count} critics were to be made of one, and its modules have no reset_parameters() that draws other "
                f"weights: pass a list of {count} critics."
            )
    return [network, *copies]


def is_stackable(network: nn.Module) -> bool:
    """Whether :func:`stacked_values` gives what the network gives.

    It does if the network wraps a module whose ``forward`` and ``forward_stacked`` are defined by the same class: where
    a subclass overrides ``forward`` alone, the inherited ``forward_stacked`` computes something else.
    """
    if _owner(network, "forward") is not TensorDictModule or network._kwargs is not None or network.method is not None:
        return False
    return "forward_stacked" in vars(_owner(network.module, "forward"))


@torch.no_grad()
def project_weights(network: nn.Module, params: TensorDictBase) -> None:
    """Scales each row of a network's unit-norm layers to norm 1, in its parameters, which may be stacked.

    Examples:
        >>> critic = TensorDictModule(UnitNormLinear(3, 1), ["observation"], ["state_action_value"])
        >>> params = TensorDict({"module": {"weight": torch.tensor([[0.0, 3.0, 4.0]])}}, [])
        >>> project_weights(critic, params)
        >>> params["module", "weight"]
        tensor([[0.0000, 0.6000, 0.8000]])
    """
    for name, layer in network.named_modules():
        if isinstance(layer, UnitNormLinear):
            weight = params.get((*name.split("."), "weight")).data
            weight.copy_(unit_rows(weight))


@contextmanager
def in_mode(network: nn.Module, *, training: bool) -> Iterator[None]:
    """Sets a network to training or evaluation, where running statistics are used and do not move, and back again."""
    modes = {module: module.training for module in network.modules()}
    network.train(training)
    try:
        yield
    finally:
        for module, mode in modes.items():
            module.training = mode


def _owner(instance: object, method: str) -> type:
    """The class that a method comes from."""
    return next((cls for cls in type(instance).__mro__ if method in vars(cls)), object)


def stacked_values(
    network: TensorDictModule, tensordict: TensorDictBase, params: TensorDictBase, *, repeated: bool = False
) -> TensorDictBase:
    """What ``vmap`` over K critics gives, without its cost: the values ``[K, *B, 1]``, or more numbers than one each.

    Args:
        network: one that :func:`is_stackable`.
        tensordict: states and actions ``[*B]``, or ``[K, *B]`` if ``repeated``.
        params: the network's parameters, stacked: ``[K]``.
        repeated: whether each critic has inputs of its own.
    """
    batch = tensordict.batch_size[1:] if repeated else tensordict.batch_size
    shape = (*params.batch_size, *batch)
    inputs = [tensordict.get(key) for key in network.in_keys]
    inputs = [value.expand(*shape, value.shape[-1]) for value in inputs]
    if len(batch) != 1:  # the batched product takes one batch dimension
        inputs = [value.reshape(shape[0], batch.numel(), value.shape[-1]) for value in inputs]
    values = network.module.forward_stacked(dict(params.get("module").flatten_keys(".").items()), *inputs)
    return TensorDict({network.out_keys[0]: values.reshape(*shape, values.shape[-1])}, shape)
