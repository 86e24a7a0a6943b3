"""The example package, and a short training with it."""

from __future__ import annotations

from pathlib import Path

OWN = Path(__file__).resolve().parents[2] / "examples/own_parts"
CONFIG_DIR, TRUSTED = ["--config-dir", str(OWN / "conf")], "packages=[own_parts]"
CHOSEN = ["env=corridor", "reward=hurry", "actor_penalty=calm"]
SMALL = [
    "trainer.episodes=6",
    "trainer.progress=false",
    "trainer.execution=eager",
    "trainer.matmul=mkl",
    "algo.learning_starts=20",
    "algo.hidden=[8]",
    "buffer.capacity=400",
]
