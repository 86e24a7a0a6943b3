"""How a process computes: which library multiplies matrices, in how many digits, and what is rounded to zero."""

import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal, TypeVar, cast

import torch
from torch import Tensor

from uavrl.errors import UavrlError

log = logging.getLogger(__name__)
T = TypeVar("T")
MatmulBackend = Literal["mkl", "onednn"]
LARGEST_ERROR = 1e-3  # of a float32 product of PROBE: some 1e-5 to 1e-4; with factors of 8 bits it is 0.1 and more
PROBE = (100, 400, 300)  # the largest product of the thesis's networks: batch and both hidden layers
GAIN = 0.95  # onednn is taken from this share of mkl's time on: a tie does not turn with the machine's load
_ON_CPU: Any = torch.backends.mkldnn.matmul  # type: ignore[attr-defined]  # PyTorch's setting; other devices have theirs
ISA = "ONEDNN_MAX_CPU_ISA"  # oneDNN reads it once, at the process's first product


def chosen_matmul(name: str, threads: int = 1) -> MatmulBackend:
    """``name``, found possible here, or for ``"auto"`` the faster of ``"mkl"`` and ``"onednn"``.

    ``mkl`` is PyTorch's default. ``onednn`` is float32 too: PyTorch hands products to oneDNN where it may round to
    bfloat16, and ``ONEDNN_MAX_CPU_ISA=AVX512_CORE`` keeps oneDNN from the instructions that would.
    """
    if name not in ("auto", "mkl", "onednn"):
        raise UavrlError(f"matmul must be one of auto, mkl, onednn, got {name!r}.")
    os.environ.setdefault(ISA, "AVX512_CORE")
    if name == "auto":
        return _faster(threads)
    if obstacle := _obstacle(name):
        raise UavrlError(f"matmul={name} is not possible here: {obstacle}.")
    return cast(MatmulBackend, name)


def matmul_here(recorded: str, threads: int = 1) -> MatmulBackend:
    """What a run has recorded; on a machine without oneDNN's products in float32 PyTorch's own, which are as good."""
    if recorded == "onednn":
        os.environ.setdefault(ISA, "AVX512_CORE")
        return "mkl" if _obstacle(recorded) else "onednn"
    return chosen_matmul(recorded, threads)


@contextmanager
def matmul_backend(name: str, threads: int = 1) -> Iterator[MatmulBackend]:
    """Multiplies by :func:`chosen_matmul`, yields its name, and gives the caller's choice back at the end.

    Devices other than the CPU multiply as before.
    """
    chosen, before = chosen_matmul(name, threads), _ON_CPU.fp32_precision
    multiply_by(chosen)
    try:
        yield chosen
    finally:
        _ON_CPU.fp32_precision = before


def multiply_by(backend: MatmulBackend) -> None:
    """Sets what multiplies in this process from now on."""
    _ON_CPU.fp32_precision = "ieee" if backend == "mkl" else "bf16"


def with_matmul_backend(function: Callable[[], T]) -> Callable[[], T]:
    """``function`` for another process, which from its call on multiplies as this one does now."""
    return partial(_after_setting, _ON_CPU.fp32_precision, os.environ.get(ISA), function)


def _after_setting(precision: str, isa: str | None, function: Callable[[], T]) -> T:
    if isa is not None:
        os.environ[ISA] = isa
    _ON_CPU.fp32_precision = precision
    return function()


@contextmanager
def denormals_flushed() -> Iterator[None]:
    """Rounds denormal numbers to zero, and gives the caller's arithmetic back at the end.

    Adam's moments of idle units decay into denormals, which the processor handles many times slower. The mode is the
    processor's: left on, it would reach every other library in this thread.
    """
    smallest = torch.tensor(torch.finfo(torch.float32).tiny)
    flushed_before = bool(smallest / 2 == 0)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(flushed_before)


def product(backend: MatmulBackend, one: Tensor, other: Tensor) -> Tensor:
    """``one @ other`` by this library, whatever the process multiplies by."""
    before = _ON_CPU.fp32_precision
    multiply_by(backend)
    try:
        return one @ other
    finally:
        _ON_CPU.fp32_precision = before


def _probe() -> tuple[Tensor, Tensor]:
    generator, (rows, inner, columns) = torch.Generator().manual_seed(0), PROBE
    return torch.randn(rows, inner, generator=generator), torch.randn(inner, columns, generator=generator)


def _obstacle(name: str) -> str | None:
    """Why this process cannot multiply so; None where it can, which a product shows."""
    if name == "mkl":
        return None
    one, other = _probe()
    result = product(cast(MatmulBackend, name), one, other)
    if torch.equal(result, product("mkl", one, other)):
        return "PyTorch does not hand products to oneDNN on this machine; choose mkl"
    error = float((result - one.double() @ other.double()).abs().max())
    if error > LARGEST_ERROR:
        return (
            f"oneDNN computes in less than float32 in this process (error {error:.1g}); start Python with "
            f"{ISA}=AVX512_CORE, or choose mkl"
        )
    return None


def _faster(threads: int) -> MatmulBackend:
    """Times the products of a layer's update with both libraries in turn, for some milliseconds."""
    if _obstacle("onednn"):
        return "mkl"
    state, weight = _probe()
    gradient = state @ weight
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    libraries: tuple[MatmulBackend, ...] = ("mkl", "onednn")
    best = dict.fromkeys(libraries, float("inf"))
    try:
        for _ in range(20):
            for name in libraries:
                begin = time.perf_counter()
                for one, other in ((state, weight), (gradient, weight.T), (state.T, gradient)):
                    product(name, one, other)
                best[name] = min(best[name], time.perf_counter() - begin)
    finally:
        torch.set_num_threads(before)
    log.debug("Products by MKL take %.3f ms, by oneDNN %.3f ms.", 1e3 * best["mkl"], 1e3 * best["onednn"])
    return "onednn" if best["onednn"] < GAIN * best["mkl"] else "mkl"
