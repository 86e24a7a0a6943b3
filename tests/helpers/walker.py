"""The walker of ``examples``, somebody else's package, and a short training with it."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from uavrl.config import compose

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/walker"
CONFIG_DIR, TRUSTED = ["--config-dir", str(EXAMPLE / "conf")], "packages=[walker]"
SMALL = [
    "env=bipedal_hardcore",
    "env.max_steps=90",  # some fall before, some do not
    "algo.batch_size=8",
    "buffer.capacity=400",
    "trainer.progress=false",
    "trainer.matmul=mkl",  # `auto` could turn with the machine's load
    "trainer.execution=captured",
]


def walker_config(*overrides: str) -> DictConfig:
    return compose(TRUSTED, *overrides, own=[EXAMPLE / "conf"])
