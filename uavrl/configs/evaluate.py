"""Settings of an evaluation. Meanings and units stand in the yaml."""

from dataclasses import dataclass, field
from typing import Annotated

from omegaconf import DictConfig

from uavrl.configs.train import Products
from uavrl.ranges import Count, Folder, Range, Seed

Valleys = Annotated[
    tuple[int, ...], Range("null or a list of seeds from 0", lambda seeds: len(seeds) > 0 and min(seeds) >= 0)
]


@dataclass
class FlyingConfig:
    """What flies where, without learning."""

    env: DictConfig
    perception: DictConfig
    reward: DictConfig
    choices: dict[str, str] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    checkpoint: Folder | None = None
    seed: Seed = 20_000
    valleys: Valleys | None = None
    output: Folder | None = None
    device: str = "cpu"
    threads: Count = 1
    products: Products = "mkl"
    progress: bool = True


@dataclass
class EvaluateConfig(FlyingConfig):
    """conf/evaluate.yaml: one evaluation."""

    episodes: Count = 500
    suite: str | tuple[str, ...] | None = None
    num_uavs: Count = 8
