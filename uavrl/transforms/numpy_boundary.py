"""Hands tensors to the functions of ``uavrl_onboard``, which take NumPy's arrays alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor


def call_numpy(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of NumPy arrays with tensors, and return its arrays as tensors.

    Gradients end here. The results are on the device of the first tensor, and of the type that the function gives them.

    Args:
        function: takes arrays and returns an array, or a list or tuple of these.
        *arguments: tensors, lists of tensors, and what needs no conversion.

    Examples:
        >>> call_numpy(np.hypot, torch.tensor([3.0, 6.0]), torch.tensor([4.0, 8.0]))
        tensor([ 5., 10.])
    """
    device = next((each.device for each in arguments if isinstance(each, Tensor)), torch.device("cpu"))
    return _to_torch(function(*map(_to_numpy, arguments)), device)


def _to_numpy(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.detach().cpu().numpy()
    return [_to_numpy(each) for each in value] if isinstance(value, list) else value


def _to_torch(value: Any, device: torch.device) -> Any:
    if isinstance(value, np.ndarray):
        return torch.from_numpy(np.ascontiguousarray(value)).to(device)
    return type(value)(_to_torch(each, device) for each in value) if isinstance(value, list | tuple) else value
