"""Gradients of a loss: as written, captured into a flat graph, or compiled."""

from __future__ import annotations

import logging
import os
import shutil
import sys
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Literal, NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from uavrl.errors import UavrlError
from uavrl.upstream import compile_graph

log = logging.getLogger(__name__)
Execution = Literal["eager", "captured", "compiled"]
LossMethod = Callable[[TensorDictBase], tuple[Tensor, dict[str, Tensor]]]


def chosen_execution(name: str) -> Execution:
    """``name``, or for ``"auto"`` the fastest that this machine has: ``"compiled"`` where there is a C++ compiler.

    Examples:
        >>> chosen_execution("eager")
        'eager'
    """
    if name != "auto":
        return cast(Execution, name)
    compiler = os.environ.get("CXX", "clang++" if sys.platform == "darwin" else "g++")
    if shutil.which(compiler):
        return "compiled"
    log.info(
        "No C++ compiler (%s) was found: updates are captured, not compiled: training is about a fifth slower.",
        compiler,
    )
    return "captured"


class Gradients(NamedTuple):
    """What one pass through a loss gives; all of it detached. A gradient may have other strides than its parameter."""

    loss: Tensor
    metadata: dict[str, Tensor]
    gradients: tuple[Tensor, ...]


def differentiate(loss_method: LossMethod, parameters: Sequence[Tensor], batch: TensorDictBase) -> Gradients:
    """Runs a loss and differentiates it with respect to ``parameters``; what it does not depend on has a gradient of 0.

    Args:
        loss_method: gives the reduced loss and metadata.
        parameters: leaves.
        batch: ``[B]``.
    """
    loss, metadata = loss_method(batch)
    gradients = torch.autograd.grad(loss, list(parameters), allow_unused=True, materialize_grads=True)
    detached = {name: value.detach() for name, value in metadata.items()}
    return Gradients(loss.detach(), detached, gradients)


class LossGradients:
    """Calls :func:`differentiate`, without Python's and TensorDict's share of its cost.

    ``captured`` records the tensor operations of the first call and replays them: the same kernels in the
    same order, hence the same numbers. ``compiled`` hands the recorded operations to TorchInductor, which
    fuses them (it rounds differently in the last digits, needs a C++ compiler, and is ``captured`` where that fails).

    ``torch.compile`` of the loss methods, with PyTorch's Adam and TorchRL's ``SoftUpdate``, takes an update about 1.4
    times as long (``benchmarks/update.py``), which is the reason for this class.

    A recording holds as long as the loss takes the same branches: ``mode`` names them, and each mode, set of
    entries, batch size, type and device is recorded once. Entries outside ``in_keys`` are not seen. Parameters and
    buffers must be changed in place.

    Args:
        loss_method: gives the reduced loss and metadata.
        parameters: leaves.
        in_keys: what the loss reads of a batch.
        execution: ``"eager"``, ``"captured"`` or ``"compiled"``.
        mode: names the branches that the loss would take now.

    Examples:
        >>> weight = torch.nn.Parameter(torch.ones(3))
        >>> gradients = LossGradients(lambda batch: ((batch["x"] * weight).sum(), {}), [weight], ["x"], "captured")
        >>> gradients(TensorDict({"x": torch.full((2, 3), 5.0)}, [2])).gradients
        (tensor([10., 10., 10.]),)
    """

    def __init__(
        self,
        loss_method: LossMethod,
        parameters: Sequence[Tensor],
        in_keys: Sequence[Any],
        execution: Execution = "captured",
        mode: Callable[[], Hashable] = tuple,
    ) -> None:
        if execution not in ("eager", "captured", "compiled"):
            raise UavrlError(f"execution must be eager, captured or compiled, got {execution!r}.")
        self.loss_method = loss_method
        self.parameters = list(parameters)
        self.in_keys = list(in_keys)
        self.execution = execution
        self.mode = mode
        self._recorded: dict[Hashable, _Recording] = {}

    def __call__(self, batch: TensorDictBase) -> Gradients:
        """The loss on ``batch [B]``, its metadata and its gradients."""
        if self.execution == "eager":
            return differentiate(self.loss_method, self.parameters, batch)
        entries = [(key, batch.get(key)) for key in self.in_keys]
        present = [(key, value) for key, value in entries if value is not None]
        inputs = [value for _, value in present]
        key = (self.mode(), tuple((str(key), value.shape, value.dtype, value.device) for key, value in present))
        if key not in self._recorded:
            self._recorded[key] = self._record(batch, [key for key, _ in present], inputs)
        return self._recorded[key](inputs)

    def _record(self, batch: TensorDictBase, keys: list[Any], inputs: list[Tensor]) -> _Recording:
        names: list[str] = []

        def flat(*leaves: Tensor) -> tuple[Tensor, ...]:
            data = TensorDict({}, batch.batch_size, device=batch.device)
            for key, leaf in zip(keys, leaves, strict=True):
                data.set(key, leaf)
            result = differentiate(self.loss_method, self.parameters, data)
            names[:] = result.metadata
            return (result.loss, *result.metadata.values(), *result.gradients)

        devices = {leaf.device.index for leaf in inputs if leaf.is_cuda}
        with torch.random.fork_rng(devices):  # recording draws random numbers; replaying draws them again
            graph = make_fx(flat)(*inputs)
        return _Recording(graph, names, inputs, self.execution == "compiled")


class _Recording:
    """The operations of one pass, and the names of what they give."""

    def __init__(self, graph: GraphModule, names: Sequence[str], inputs: list[Tensor], compiled: bool) -> None:
        self.names = list(names)
        self.constants: list[Tensor] = []
        self.run: Callable[..., Any] = graph
        if compiled:
            self.constants = _lift_constants(graph)
            self.run = _compile(graph, [*inputs, *self.constants])

    @torch.no_grad()
    def __call__(self, inputs: Sequence[Tensor]) -> Gradients:
        loss, *rest = self.run(*inputs, *self.constants)
        count = len(self.names)
        return Gradients(loss, dict(zip(self.names, rest, strict=False)), tuple(rest[count:]))


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
