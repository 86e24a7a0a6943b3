"""Typed configuration of an evaluation. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uavrl.configs.checks import require, require_products


@dataclass
class EvaluateConfig:
    """conf/evaluate.yaml: one evaluation."""

    run: str | None = None
    policy: str | None = None
    env: Any = None
    perception: Any = None
    episodes: int = 500
    seed: int = 20_000
    valleys: tuple[int, ...] | None = None
    suite: Any = None  # a name, or a list of names
    checkpoint: str | None = None
    output: str | None = None
    num_uavs: int = 8
    device: str = "cpu"
    threads: int = 1
    products: str = "mkl"
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        for key in ("episodes", "num_uavs", "threads"):
            require(getattr(self, key) >= 1, key, "at least 1", getattr(self, key))
        seeds = self.valleys
        require(
            seeds is None or (len(seeds) > 0 and min(seeds) >= 0), "valleys", "null or a list of seeds from 0", seeds
        )
        require(0 <= self.seed < 2**31, "seed", "in [0, 2**31)", self.seed)
        require_products(self.products)
