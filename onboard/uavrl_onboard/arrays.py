"""What functions need that take arrays of numpy as well as tensors of PyTorch, which they do not load."""

import sys
from typing import Any

import numpy as np

Array = Any  # an ndarray, or a Tensor


def library_of(values: Array) -> Any:
    """What an array is of: numpy or torch."""
    return sys.modules[type(values).__module__.partition(".")[0]]


def like(constant: np.ndarray, values: Array) -> Array:
    """A constant as such an array, of its type and where it is."""
    return values.new_tensor(constant) if hasattr(values, "new_tensor") else constant.astype(values.dtype)
