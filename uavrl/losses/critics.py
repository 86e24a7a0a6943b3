"""Several critics evaluated as one."""

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn


def is_stackable(network: nn.Module) -> bool:
    """Whether :func:`stacked_values` gives what the network gives.

    It does if the network wraps a module whose ``forward`` and ``forward_stacked`` are defined by the same class: where
    a subclass overrides ``forward`` alone, the inherited ``forward_stacked`` computes something else.
    """
    if _owner(network, "forward") is not TensorDictModule or network._kwargs is not None or network.method is not None:
        return False
    return "forward_stacked" in vars(_owner(network.module, "forward"))


def _owner(instance: object, method: str) -> type:
    """The class that a method comes from."""
    return next((cls for cls in type(instance).__mro__ if method in vars(cls)), object)


def stacked_values(
    network: TensorDictModule, tensordict: TensorDictBase, params: TensorDictBase, *, repeated: bool = False
) -> TensorDictBase:
    """What ``vmap`` over K critics gives, without its cost: the values ``[K, *B, 1]``.

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
    return TensorDict({network.out_keys[0]: values if len(batch) == 1 else values.reshape(*shape, 1)}, shape)
