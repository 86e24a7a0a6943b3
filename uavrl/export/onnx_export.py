"""A policy's network as ONNX: from the state to the action, for programs without PyTorch.

The network of a policy with a memory also takes what it remembers, and gives what it remembers next.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from uavrl.errors import UavrlError
from uavrl.exploration import deterministic
from uavrl.models.memory import IS_INIT, MEMORY, RECURRENT_STATE, RecurrentPolicy

OPSET = 18  # that PyTorch exports to; the file names the oldest that defines the same operators
FUNCTIONS = 8  # the oldest IR version in which a model may hold functions of its own
INPUT, OUTPUT = "state", "action"
MEMORY_INPUT, MEMORY_OUTPUT = "memory", "next_memory"
TRIED, TOLERANCE = 32, 1e-5  # states in which what was exported must act as the policy does
LEFT_OUT = "policy.onnx is left out"


class _MeanAction(nn.Module):
    """States ``[N, S]`` to a policy's actions without noise ``[N, A]``, cut to their limits."""

    def __init__(self, actor: TensorDictModuleBase, low: Sequence[float], high: Sequence[float]) -> None:
        super().__init__()
        self.actor = actor
        self.register_buffer("low", torch.tensor(low, dtype=torch.float32))
        self.register_buffer("high", torch.tensor(high, dtype=torch.float32))

    def forward(self, state: Tensor, memory: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        read = TensorDict({"observation": state}, batch_size=state.shape[:1])
        if memory is None:
            return self.actor(read)["action"].clamp(self.low, self.high)
        remembered = self.actor.memory.advance(state, memory)
        acted = self.actor.head(read.set(MEMORY, remembered))
        return acted["action"].clamp(self.low, self.high), remembered

    def as_flown(self, state: Tensor, memory: Tensor | None = None) -> list[np.ndarray]:
        """What :meth:`forward` must give, by the policy itself."""
        if memory is None:
            read = TensorDict({"observation": state}, batch_size=state.shape[:1])
            return [self.actor(read)["action"].clamp(self.low, self.high).numpy()]
        carried = {"observation": state, RECURRENT_STATE: memory[:, None], IS_INIT: torch.zeros(len(state), 1) > 0}
        acted = self.actor(TensorDict(carried, batch_size=state.shape[:1]))
        action, following = acted["action"].clamp(self.low, self.high), acted["next", RECURRENT_STATE][:, 0]
        return [action.numpy(), following.numpy()]


def policy_onnx(actor: TensorDictModuleBase, size: int, low: Sequence[float], high: Sequence[float]) -> bytes:
    """Return the file of a policy: no path and no date is in it, so that the same policy is the same file.

    The file names the oldest opset and IR version that define its operators, so that old versions of ONNX Runtime open
    it.

    Args:
        actor: the policy.
        size: numbers in a state.
        low: the lower limits of an action.
        high: its upper limits.

    Raises:
        UavrlError: where the extra ``export`` is not installed, PyTorch cannot export the policy's network, or the
            exported network acts differently.
    """
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise UavrlError(
            f"{LEFT_OUT}, which lets the policy act without PyTorch: it needs {error.name}. To have it, pip install "
            f"'uavrl[export]' and export again to another folder."
        ) from error
    acts, generator = _MeanAction(actor, low, high), torch.Generator().manual_seed(0)
    tried = {INPUT: torch.randn(TRIED, size, generator=generator, dtype=torch.float32)}
    if isinstance(actor, RecurrentPolicy):
        tried[MEMORY_INPUT] = 2 * torch.rand(TRIED, actor.memory.size, generator=generator, dtype=torch.float32) - 1
    training = {module: module.training for module in acts.modules()}
    acts.eval()
    try:
        with _quiet(), torch.no_grad(), torch.random.fork_rng(devices=[]):
            content = _exported(acts, tried)
            pairs = zip(_acted(content, tried), acts.as_flown(*tried.values()), strict=True)
            apart = max(np.abs(exported - own).max() for exported, own in pairs)
    except Exception as error:  # whatever somebody else's network raises
        raise UavrlError(f"{LEFT_OUT}: PyTorch cannot export the policy's network ({_reason(error)}).") from error
    finally:
        for module, mode in training.items():
            module.training = mode
    if not apart <= TOLERANCE:
        raise UavrlError(
            f"{LEFT_OUT}: what PyTorch exported acts otherwise than the policy, by up to {apart:.2g}. A network that "
            f"draws numbers, or keeps some from one state to the next, has no such file."
        )
    return content


def _exported(acts: nn.Module, tried: Mapping[str, Tensor]) -> bytes:
    from onnx_ir.passes.common import ClearMetadataAndDocStringPass

    batch = torch.export.Dim("batch")
    program = torch.onnx.export(
        acts,
        tuple(tried.values()),
        dynamo=True,
        opset_version=OPSET,
        input_names=list(tried),
        output_names=[OUTPUT, MEMORY_OUTPUT][: len(tried)],
        dynamic_shapes={name: {0: batch} for name in tried},
        external_data=False,
        verbose=False,
    )
    assert program is not None, "no file was named"
    ClearMetadataAndDocStringPass()(program.model)  # where the code lay that was traced
    return _for_old_runtimes(program.model_proto).SerializeToString(deterministic=True)


def _for_old_runtimes(model: Any) -> Any:
    """Name the oldest opset and IR version that hold a model, and leave out metadata that older ones do not know.

    An operator is the same in all opsets from the one that last changed it to the next one that does.
    """
    import onnx

    for values in (model.graph.input, model.graph.output, model.graph.value_info, model.graph.initializer):
        for value in values:
            value.ClearField("metadata_props")
    (opset,) = (each for each in model.opset_import if each.domain == "")
    nodes = list(_nodes(model.graph))
    if not model.functions and all(node.domain == "" for node in nodes):
        opset.version = max(onnx.defs.get_schema(node.op_type, opset.version).since_version for node in nodes)
    oldest = onnx.helper.find_min_ir_version_for([opset], ignore_unknown=True)
    model.ir_version = max(oldest, FUNCTIONS) if model.functions else oldest
    onnx.checker.check_model(model, full_check=True)
    return model


def _nodes(graph: Any) -> Iterator[Any]:
    """Return the operators of a graph and of the graphs in it."""
    for node in graph.node:
        yield node
        for attribute in node.attribute:
            for inner in (attribute.g, *attribute.graphs):
                yield from _nodes(inner)


def opset_of(content: bytes) -> int:
    """Return the version of ONNX's operators that a file asks for."""
    import onnx

    return next(int(each.version) for each in onnx.load_from_string(content).opset_import if each.domain == "")


def _acted(content: bytes, tried: Mapping[str, Tensor]) -> list[np.ndarray]:
    """What an exported policy gives, by ONNX's reference implementation."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    read = {name: values.numpy() for name, values in tried.items()}
    return [np.asarray(values) for values in ReferenceEvaluator(onnx.load_from_string(content)).run(None, read)]


@contextmanager
def _quiet() -> Iterator[None]:
    """A policy acts without noise, and what PyTorch reports of its exporter is kept off the screen."""
    disabled = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with deterministic():
                yield
    finally:
        logging.disable(disabled)


def _reason(error: BaseException) -> str:
    """The first line of the error that began it."""
    while error.__cause__ is not None:
        error = error.__cause__
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)[:200]
