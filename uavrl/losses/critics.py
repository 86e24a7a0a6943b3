"""Several critics evaluated as one."""

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn


def is_stackable(network: nn.Module) -> bool:
    """Whether :func:`stacked_values` says the same as the network.

    A network does that wraps a module whose ``forward`` has a ``forward_stacked`` beside it, in the same class: where a
    subclass has another ``forward``, the inherited ``forward_stacked`` is that of another network.
    """
    if _owner(network, "forward") is not TensorDictModule or network._kwargs is not None or network.method is not None:
        return False
    return "forward_stacked" in vars(_owner(network.module, "forward"))


def _owner(instance: object, method: str) -> type:
    """The class that a method comes from."""
    return next((cls for cls in type(instance).__mro__ if method in vars(cls)), object)


def stacked_values(network: TensorDictModule, params: TensorDictBase, states: Tensor, actions: Tensor) -> Tensor:
    """What ``vmap`` over K critics gives, without its cost.

    Args:
        network: one that :func:`is_stackable`.
        params: its parameters, stacked: ``[K]``.
        states: ``[K, *B, observations]``.
        actions: ``[K, *B, actions]``.

    Returns:
        The values ``[K, *B, 1]``.
    """
    batch = states.shape[1:-1]
    if len(batch) != 1:  # the batched product takes one batch dimension
        shape = (states.shape[0], batch.numel(), -1)
        return stacked_values(network, params, states.reshape(shape), actions.reshape(shape)).unflatten(1, batch)
    parameters = dict(params.get("module").flatten_keys(".").items())
    return network.module.forward_stacked(parameters, states, actions)
