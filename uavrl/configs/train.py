"""Settings of a training. Meanings and units stand in the yaml."""

from dataclasses import dataclass, field
from typing import Literal

from omegaconf import DictConfig, OmegaConf

from uavrl.configs.checks import require
from uavrl.ranges import Count, Folder, Positive, Seed, Share

NAVIGATION_STATE = "uavrl.transforms.state.NavigationState"  # whose mirror image is known
Execution = Literal["eager", "captured", "compiled", "auto"]
Products = Literal["mkl", "onednn", "bf16", "auto"]


@dataclass
class TrainerConfig:
    """conf/trainer."""

    episodes: Count = 5000
    steps: Count | None = None
    until_success: Share | None = None
    updates_per_step: Positive = 1.0
    window: Count = 500
    checkpoint_interval: Count = 20_000
    keep_checkpoints: Count = 2
    threads: Count = 1
    execution: Execution = "auto"
    products: Products = "auto"
    progress: bool = True


@dataclass
class TrainConfig:
    """conf/config.yaml: one training run. A part holds its class and what that takes.

    Attributes:
        choices: the yaml file of each part, by the part's name.
        packages: packages whose classes may be named, beside uavrl.
    """

    env: DictConfig
    perception: DictConfig
    reward: DictConfig
    algo: DictConfig
    fork: DictConfig
    lifeguard: DictConfig
    enhancer: DictConfig
    buffer: DictConfig
    backward_reward: DictConfig
    collector: DictConfig
    logger: DictConfig
    trainer: TrainerConfig
    guide: DictConfig = field(default_factory=lambda: OmegaConf.create({"_target_": None}))
    choices: dict[str, str] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    seed: Seed = 0
    device: str = "cpu"
    run_dir: Folder = "runs"
    resume: Folder | None = None

    @property
    def guided(self) -> bool:
        """Whether the first steps are a guide's."""
        return self.guide.get("_target_") is not None

    def __post_init__(self) -> None:
        """Checks what a range cannot say."""
        require(bool(self.run_dir.strip()), "run_dir", "a folder to make", self.run_dir)
        require(self.resume is None or bool(self.resume.strip()), "resume", "the folder of a run", self.resume)
        single = all(part.get("_target_") is None for part in (self.fork, self.lifeguard))
        steps = self.algo.get("n_steps", 1)
        require(steps == 1 or single, "algo.n_steps", "1 with FORK or LifeGuard: they learn from single steps", steps)
        known = self.perception.get("angles") == "folded" and self.perception.get("_target_") == NAVIGATION_STATE
        mirrors = known or not self.buffer.get("mirror")
        require(mirrors, "buffer.mirror", "false, but with uavrl's perception and perception.angles=folded", True)
