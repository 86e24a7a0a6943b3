"""Tensors become arrays and arrays become tensors, at one place."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from uavrl.transforms.numpy_boundary import call_numpy


def test_it_converts_tensors_and_lists_and_leaves_the_rest() -> None:
    seen = []

    def function(first: np.ndarray, several: list[np.ndarray], number: float) -> tuple[np.ndarray, np.ndarray]:
        seen.extend([type(first), [type(each) for each in several], number])
        return first * number, first > 1.0

    scaled, above = call_numpy(function, torch.tensor([1.0, 2.0], requires_grad=True), [torch.ones(1)], 3.0)
    assert seen == [np.ndarray, [np.ndarray], 3.0]
    assert (scaled.tolist(), scaled.dtype, scaled.requires_grad) == ([3.0, 6.0], torch.float32, False)
    assert (above.tolist(), above.dtype) == ([False, True], torch.bool)


def test_results_go_where_the_first_tensor_is() -> None:
    """No GPU is needed: the meta device shows where tensors are put."""
    put: list[Tensor] = []

    class Elsewhere(Tensor):
        @property
        def device(self) -> torch.device:  # type: ignore[override]
            return torch.device("meta")

    put.append(call_numpy(lambda array: np.asarray(array) + 1.0, torch.ones(2).as_subclass(Elsewhere)))
    assert put[0].device == torch.device("meta")
