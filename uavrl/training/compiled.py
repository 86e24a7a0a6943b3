"""An update without what Python, TensorDict and PyTorch's bookkeeping cost around its kernels.

Why not the stock tools: ``torch.compile`` of the same losses with PyTorch's fused Adam and TorchRL's ``SoftUpdate``
takes an update 1.41 times as long (``benchmarks/update.py``).
"""

from __future__ import annotations

import logging
import os
import shutil
import sys
import sysconfig
from collections.abc import Callable, Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx
from torchrl.objectives import SoftUpdate

from uavrl.errors import UavrlError
from uavrl.losses.actor_penalty import LossMethod
from uavrl.upstream import add, compile_graph, fused_adam, lerp

log = logging.getLogger(__name__)
Execution = Literal["eager", "captured", "compiled"]


def chosen_execution(name: str) -> Execution:
    """``name``, or for ``"auto"`` the fastest here: ``"compiled"`` where C++ can be compiled for Python."""
    if name != "auto":
        return cast(Execution, name)
    compiler = os.environ.get("CXX", "clang++" if sys.platform == "darwin" else "g++")
    headers = Path(sysconfig.get_path("include"), "Python.h")
    missing = [what for what, there in ((compiler, shutil.which(compiler)), (headers, headers.is_file())) if not there]
    if not missing:
        return "compiled"
    log.info(
        "%s, which compiling needs, was not found: updates are captured, not compiled: training is about a fifth "
        "slower. On Debian and Ubuntu: apt install g++ python3-dev.",
        missing[0],
    )
    return "captured"


class Gradients(NamedTuple):
    """What one pass through a loss gives; all of it detached. A gradient may have other strides than its parameter."""

    loss: Tensor
    metadata: dict[str, Tensor]
    gradients: tuple[Tensor, ...]


def differentiate(loss_method: LossMethod, parameters: Sequence[Tensor], batch: TensorDictBase) -> Gradients:
    """A loss and its gradients in ``parameters``, 0 for those that it does not depend on."""
    loss, metadata = loss_method(batch)
    gradients = torch.autograd.grad(loss, list(parameters), allow_unused=True, materialize_grads=True)
    detached = {name: value.detach() for name, value in metadata.items()}
    return Gradients(loss.detach(), detached, gradients)


class LossGradients:
    """Calls :func:`differentiate`, without Python's and TensorDict's share of its cost.

    ``captured`` records the tensor operations of the first call and replays them: the same kernels in the
    same order, hence the same numbers. ``compiled`` hands the recorded operations to TorchInductor, which
    fuses them (it rounds differently in the last digits, needs a C++ compiler, and is ``captured`` where that fails).

    A recording holds as long as the loss takes the same branches: ``mode()`` names them, and each mode, set of
    entries, batch size, type and device is recorded once. Parameters and buffers must be changed in place.
    ``in_keys`` are what the loss reads of a batch, None for all there is. ``statistics`` are the buffers that the loss
    changes in place.

    Examples:
        >>> weight = torch.nn.Parameter(torch.ones(3))
        >>> gradients = LossGradients(lambda batch: ((batch["x"] * weight).sum(), {}), [weight], "captured")
        >>> gradients(TensorDict({"x": torch.full((2, 3), 5.0)}, [2])).gradients
        (tensor([10., 10., 10.]),)
    """

    def __init__(
        self,
        loss_method: LossMethod,
        parameters: Sequence[Tensor],
        execution: Execution = "captured",
        in_keys: Sequence[Any] | None = None,
        mode: Callable[[], Hashable] = tuple,
        statistics: Sequence[Tensor] = (),
    ) -> None:
        if execution not in ("eager", "captured", "compiled"):
            raise UavrlError(f"execution must be eager, captured or compiled, got {execution!r}.")
        self.loss_method = loss_method
        self.parameters = list(parameters)
        self.in_keys = in_keys
        self.execution = execution
        self.mode = mode
        self.statistics = list(statistics)
        self._recorded: dict[Hashable, Callable[[Sequence[Tensor]], Gradients]] = {}

    def __call__(self, batch: TensorDictBase) -> Gradients:
        """The loss on ``batch [B]``, its metadata and its gradients."""
        if self.execution == "eager":
            return differentiate(self.loss_method, self.parameters, batch)
        keys = batch.keys(True, True) if self.in_keys is None else self.in_keys
        entries = {key: value for key in keys if (value := batch.get(key)) is not None}
        key = (self.mode(), tuple((str(key), value.shape, value.dtype, value.device) for key, value in entries.items()))
        inputs = list(entries.values())
        if key not in self._recorded:
            self._recorded[key] = self._record(batch, list(entries), inputs)
        return self._recorded[key](inputs)

    def _record(
        self, batch: TensorDictBase, keys: list[Any], inputs: list[Tensor]
    ) -> Callable[[Sequence[Tensor]], Gradients]:
        names: list[str] = []

        def flat(*leaves: Tensor) -> tuple[Tensor, ...]:
            data = TensorDict({}, batch.batch_size, device=batch.device)
            for key, leaf in zip(keys, leaves, strict=True):
                data.set(key, leaf)
            result = differentiate(self.loss_method, self.parameters, data)
            names[:] = result.metadata
            return (result.loss, *result.metadata.values(), *result.gradients)

        devices = {leaf.device.index for leaf in inputs if leaf.is_cuda}
        before = [each.clone() for each in self.statistics]
        with torch.random.fork_rng(devices):  # recording draws random numbers; replaying draws them again
            graph = make_fx(flat)(*inputs)
        for each, value in zip(self.statistics, before, strict=True):
            each.copy_(value)
        constants = _lift_constants(graph) if self.execution == "compiled" else []
        run = _compile(graph, [*inputs, *constants]) if self.execution == "compiled" else graph
        recorded = tuple(names)

        @torch.no_grad()
        def replay(inputs: Sequence[Tensor]) -> Gradients:
            loss, *rest = run(*inputs, *constants)
            return Gradients(loss, dict(zip(recorded, rest, strict=False)), tuple(rest[len(recorded) :]))

        return replay


def _lift_constants(graph: GraphModule) -> list[Tensor]:
    """Turns the parameters and buffers of a graph into inputs, in place, and returns them."""
    nodes = graph.graph
    last = [node for node in nodes.nodes if node.op == "placeholder"][-1]
    lifted: dict[str, Any] = {}
    for node in [node for node in nodes.nodes if node.op == "get_attr"]:
        name = str(node.target)
        if name not in lifted:
            with nodes.inserting_after(last):
                last = lifted[name] = nodes.placeholder(f"lifted_{name}")
        node.replace_all_uses_with(lifted[name])
        nodes.erase_node(node)
    graph.recompile()
    return [getattr(graph, name).detach() for name in lifted]


def _compile(graph: GraphModule, inputs: list[Any]) -> Callable[..., Any]:
    try:
        with torch.no_grad():
            split = make_fx(graph, SPLIT, tracing_mode="fake")(*inputs) if inputs[0].device.type == "cpu" else graph
            return compile_graph(split, inputs, fallback_random=True)
    except Exception as error:  # a run is worth more than a fifth of its speed
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        log.warning("The update could not be compiled (%s): it is captured instead, which is slower.", reason)
        return graph


def _sum_after_product(bias: Tensor, one: Tensor, other: Tensor, *, beta: float = 1, alpha: float = 1) -> Tensor:
    """``addmm`` and ``baddbmm`` in two: on the CPU they fill their output with the bias before they multiply.

    Inductor fuses the sum with the operations after it.
    """
    if one.ndim == 2:  # as a batch of one, which Inductor does not turn back into addmm
        return (beta * bias + alpha * torch.bmm(one[None], other[None]))[0]
    return beta * bias + alpha * torch.bmm(one, other)


SPLIT = dict.fromkeys((torch.ops.aten.addmm.default, torch.ops.aten.baddbmm.default), _sum_after_product)


class FusedAdam(torch.optim.Adam):
    """PyTorch's fused Adam for parameters that all have a gradient at every step: same numbers, same ``state_dict``.

    ``torch.optim.Adam.step`` regroups its tensors at every call; :meth:`apply` gathers them once. The kernel walks
    through the memory of each tensor and asks for no strides, so what it is given is first laid out as the parameter.
    A parameter that shares or skips memory, such as an expanded one, is refused.

    Examples:
        >>> weight = torch.nn.Parameter(torch.ones(2))
        >>> FusedAdam([weight], lr=0.1).apply([torch.tensor([1.0, -1.0])])
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
    def apply(self, gradients: Sequence[Tensor]) -> None:
        """One step along ``gradients``, which come in the order of the parameters and with any strides."""
        if self._gathered is None:
            self._gathered = self._gather()
        parameters, averages, squares, steps = self._gathered
        add(steps, 1)
        laid_out = [_laid_out(gradient, like) for gradient, like in zip(gradients, parameters, strict=True)]
        lr, (beta1, beta2), eps = (self.param_groups[0][name] for name in ("lr", "betas", "eps"))
        settings = {"lr": lr, "beta1": beta1, "beta2": beta2, "weight_decay": 0.0, "eps": eps}
        fused_adam(parameters, laid_out, averages, squares, [], steps, amsgrad=False, maximize=False, **settings)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what ``state_dict`` gave."""
        super().load_state_dict(state_dict)
        self._gathered = None

    def _gather(self) -> tuple[list[Tensor], ...]:
        """Parameters, mean gradients, mean squares and step counts."""
        parameters = self.param_groups[0]["params"]
        for parameter in parameters:
            state = self.state[parameter]
            if not state:
                state["step"] = torch.zeros((), dtype=torch.float32, device=parameter.device)
                state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(parameter), torch.zeros_like(parameter)
            for name in ("exp_avg", "exp_avg_sq"):  # loaded ones may lie otherwise
                state[name] = _laid_out(state[name], parameter)
        states = [self.state[parameter] for parameter in parameters]
        return list(parameters), *([state[name] for state in states] for name in ("exp_avg", "exp_avg_sq", "step"))


def _laid_out(tensor: Tensor, like: Tensor) -> Tensor:
    """The tensor with the strides of another; itself where it has them."""
    return tensor if tensor.stride() == like.stride() else torch.empty_like(like).copy_(tensor)


class GradientStep:
    """A step of Adam along the gradients of a loss.

    ``tensors`` are the parameters to train, and the buffers that the loss changes, which need no gradients.
    """

    def __init__(
        self,
        loss_method: LossMethod,
        tensors: Iterable[Tensor],
        lr: float,
        execution: Execution,
        in_keys: Sequence[Any] | None = None,
        mode: Callable[[], Hashable] = tuple,
    ) -> None:
        tensors = list(tensors)
        parameters = [tensor for tensor in tensors if tensor.requires_grad]
        statistics = [tensor for tensor in tensors if not tensor.requires_grad]
        self.gradients = LossGradients(loss_method, parameters, execution, in_keys, mode, statistics)
        self.optimizer = FusedAdam(parameters, lr=lr)

    def __call__(self, batch: TensorDictBase) -> Gradients:
        """One step; returns what it was based on."""
        result = self.gradients(batch)
        for parameter, gradient in zip(self.gradients.parameters, result.gradients, strict=True):
            parameter.grad = gradient  # for whoever wants to look
        self.optimizer.apply(result.gradients)
        return result


class FusedSoftUpdate(SoftUpdate):
    """TorchRL's soft update (Eq. 2.9: ``θ' ← τ θ + (1 - τ) θ'``) of all parameters in one call."""

    _pairs: list[tuple[Tensor, Tensor]] | None = None

    def step(self) -> None:
        """Moves the targets."""
        if self._pairs is None:
            self._pairs = [
                (source.data, self._targets[(f"target_{key[0]}", *key[1:])].data)
                for key, source in self._sources.items(True, True)
            ]
        sources, targets = zip(*self._pairs, strict=True)
        lerp(list(targets), list(sources), 1 - self.eps)
