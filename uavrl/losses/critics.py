"""Several critics evaluated as one."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor


def stacked_values(network: TensorDictModule, params: TensorDictBase, states: Tensor, actions: Tensor) -> Tensor:
    """What ``vmap`` over K critics gives, without its cost.

    Args:
        network: wraps a :class:`uavrl.models.Critic`.
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
