"""Adam without the bookkeeping around its kernel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from uavrl.errors import UavrlError
from uavrl.upstream import fused_adam


class DirectAdam(torch.optim.Adam):
    """PyTorch's fused Adam for parameters that all have a gradient at every step: same numbers, same ``state_dict``.

    ``torch.optim.Adam.step`` regroups its tensors at every call, which costs as much as the update itself when the
    networks are small. Here they are gathered once, and :meth:`descend` takes the place of ``step``.

    The kernel walks through the memory of each tensor and asks for no strides, so what it is given is first laid out as
    the parameter is.

    Args:
        params: the parameters.
        lr: step size.

    Raises:
        UavrlError: for a parameter that shares or skips memory, such as an expanded one.

    Examples:
        >>> weight = torch.nn.Parameter(torch.ones(2))
        >>> DirectAdam([weight], lr=0.1).descend([torch.tensor([1.0, -1.0])])
        >>> weight
        Parameter containing:
        tensor([0.9000, 1.1000], requires_grad=True)
    """

    def __init__(self, params: Iterable[Tensor], lr: float) -> None:
        super().__init__(params, lr=lr, fused=True)
        self._gathered: tuple[list[Tensor], ...] | None = None
        for parameter in self.param_groups[0]["params"]:
            if torch.empty_like(parameter).stride() != parameter.stride():
                raise UavrlError(
                    f"Expected parameters that fill their memory, got one of shape {tuple(parameter.shape)} with "
                    f"strides {parameter.stride()}: give each network weights of its own, or clone them."
                )

    @torch.no_grad()
    def descend(self, gradients: Sequence[Tensor]) -> None:
        """One step along ``gradients``, which come in the order of the parameters and with any strides."""
        if self._gathered is None:
            self._gathered = self._gather()
        parameters, averages, squares, steps = self._gathered
        steps[0] += 1
        group = self.param_groups[0]
        fused_adam(
            parameters,
            [_laid_out(gradient, like) for gradient, like in zip(gradients, parameters, strict=True)],
            averages,
            squares,
            [],
            steps,
            lr=group["lr"],
            beta1=group["betas"][0],
            beta2=group["betas"][1],
            weight_decay=0.0,
            eps=group["eps"],
            amsgrad=False,
            maximize=False,
        )

    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """Not for use.

        Raises:
            TypeError: always.
        """
        raise TypeError("DirectAdam takes its gradients as an argument: call descend(gradients).")

    def state_dict(self) -> dict[str, Any]:
        """What ``torch.optim.Adam`` gives, each parameter with a step count of its own."""
        saved = super().state_dict()
        states = {key: {**state, "step": state["step"].clone()} for key, state in saved["state"].items()}
        return {**saved, "state": states}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what ``state_dict`` gave."""
        super().load_state_dict(state_dict)
        self._gathered = None

    def _gather(self) -> tuple[list[Tensor], ...]:
        """Parameters, mean gradients, mean squares, and the step count, which is one tensor for all."""
        parameters = self.param_groups[0]["params"]
        for parameter in parameters:
            state = self.state[parameter]
            if not state:
                state["step"] = torch.zeros((), dtype=torch.float32, device=parameter.device)
                state["exp_avg"] = torch.zeros_like(parameter)
                state["exp_avg_sq"] = torch.zeros_like(parameter)
            for name in ("exp_avg", "exp_avg_sq"):  # loaded ones may lie otherwise
                state[name] = _laid_out(state[name], parameter)
        step = self.state[parameters[0]]["step"]
        for parameter in parameters:
            self.state[parameter]["step"] = step
        states = [self.state[parameter] for parameter in parameters]
        averages, squares = [s["exp_avg"] for s in states], [s["exp_avg_sq"] for s in states]
        return list(parameters), averages, squares, [step] * len(states)


def _laid_out(tensor: Tensor, like: Tensor) -> Tensor:
    """The tensor with the strides of another; itself where it has them."""
    return tensor if tensor.stride() == like.stride() else torch.empty_like(like).copy_(tensor)
