"""Settings of a training, and of what flies without learning. Meanings and units stand in the yaml."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field

from uavrl.config.parts import Part
from uavrl.config.schedules import work_out
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.ranges import Count, Folder, Rule, Seed, Text
from uavrl_onboard.sentences import require

ExecutionChoice = Literal["eager", "captured", "compiled", "auto"]
MatmulChoice = Literal["mkl", "onednn", "auto"]
Threads = Annotated[int, Field(ge=1, le=256)]
Valleys = Annotated[
    tuple[int, ...], Rule("null or a list of seeds from 0", lambda seeds: len(seeds) > 0 and min(seeds) >= 0)
]


FlownValleys = Annotated[
    Literal["unseen", "training"] | tuple[int, ...],
    Rule(
        "unseen, training or a list of seeds from 0",
        lambda given: isinstance(given, str) or min(given, default=-1) >= 0,
    ),
]


@dataclass
class TrainerConfig:
    """conf/trainer."""

    episodes: Count = 5000
    steps: Count | None = None
    until_success: Annotated[float, Field(gt=0, lt=1)] | None = None
    updates_per_step: Annotated[float, Field(gt=0, le=100)] = 1.0
    window: Count = 500
    checkpoint_interval: Count = 20_000
    keep_checkpoints: Count = 2
    lidar_stride: Annotated[int, Field(ge=1, le=50)] = 1
    threads: Threads = 1
    execution: ExecutionChoice = "auto"
    matmul: MatmulChoice = "auto"
    progress: bool = True


@dataclass
class TrainConfig:
    """conf/config.yaml: one training run. A part holds its class and what that takes.

    Attributes:
        choices: the yaml file of each part, by the part's name.
        packages: packages whose classes may be named, beside uavrl.
        guards: as :func:`uavrl_onboard.guards.settings.guard_settings` reads them.
    """

    env: Part
    perception: Part
    reward: Part
    algo: Part
    fork: Part
    lifeguard: Part
    actor_penalty: Part
    buffer: Part
    backward_reward: Part
    collector: Part
    logger: Part
    trainer: TrainerConfig
    demonstrator: Part = field(default_factory=lambda: Part(_target_=None))
    smoothness: Part = field(default_factory=lambda: Part(_target_=None))
    cloning: Part = field(default_factory=lambda: Part(_target_=None))
    validation: Part = field(default_factory=lambda: Part(_target_=None))
    recurrent: Part = field(default_factory=lambda: Part(_target_=None))
    choices: dict[str, str] = field(default_factory=dict)
    packages: tuple[Text, ...] = ()
    guards: Any = None
    seed: Seed = 0
    device: str = "cpu"
    run_dir: Folder = "runs"
    resume: Folder | None = None

    @property
    def demonstrated(self) -> bool:
        """Whether a demonstrator flies the first steps."""
        return self.demonstrator.get("_target_") is not None

    def __post_init__(self) -> None:
        """Checks what a range cannot say."""
        require(bool(self.run_dir.strip()), "run_dir", "a folder to make", self.run_dir)
        require(self.resume is None or bool(self.resume.strip()), "resume", "the folder of a run", self.resume)
        guard_settings(self.guards)
        work_out(
            self.algo,
            self.cloning,
            steps=self.trainer.steps,
            updates_per_step=self.trainer.updates_per_step,
            demonstrated=self.demonstrated,
        )


@dataclass
class FlyingConfig:
    """What flies where, without learning."""

    env: Part
    perception: Part
    reward: Part
    choices: dict[str, str] = field(default_factory=dict)
    packages: tuple[Text, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    vecnormalize: Folder | None = None
    checkpoint: Folder | None = None
    seed: Seed = 20_000
    valleys: FlownValleys = "unseen"
    guards: Any = None
    allow_unseen: bool = False
    output: Folder | None = None
    device: str = "cpu"
    threads: Threads = 1
    matmul: MatmulChoice = "mkl"
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks the names and the settings of guards, and what only a model of Stable-Baselines3 has."""
        fits = self.vecnormalize is None or (self.policy or "").endswith(".zip")
        require(fits, "vecnormalize", "left out unless policy=MODEL.zip is given", self.vecnormalize)
        guard_settings(self.guards, GuardSettings.all())


@dataclass
class EvaluateConfig(FlyingConfig):
    """conf/evaluate.yaml: one evaluation."""

    episodes: Count = 500
    suite: str | tuple[Text, ...] | None = None
    num_uavs: Annotated[int, Field(ge=1, le=512)] = 8
    processes: Annotated[int, Field(ge=1, le=512)] | None = 1
