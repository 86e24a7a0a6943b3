"""Builds environment, buffer and collector from a configuration."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import PrioritizedSampler, RandomSampler, TensorDictReplayBuffer
from torchrl.envs import Compose, EnvBase, RewardSum, Transform, TransformedEnv
from torchrl.modules import AdditiveGaussianModule

from uavrl.buffers import BackwardReward, FailureBias, FrameStorage, MultiStep
from uavrl.configs.algo import DDPGConfig
from uavrl.configs.buffer import (
    ABRConfig,
    ABRPlusConfig,
    FailureBiasedBufferConfig,
    NoBackwardRewardConfig,
    PrioritizedBufferConfig,
    UniformBufferConfig,
)
from uavrl.configs.train import TrainConfig
from uavrl.configs.valley import EnvConfig, NavigationRewardConfig, PerceptionConfig, TraditionalRewardConfig
from uavrl.configs.walker import BipedalConfig, NoPerceptionConfig, WalkerRewardConfig
from uavrl.envs.bipedal import BipedalEnv
from uavrl.envs.navigation import GoalAngle, Hidden, NavigationEnv
from uavrl.errors import UavrlError
from uavrl.models import OneShotClassifier, TrajectoryClassifier
from uavrl.models.trajectory_classifier import ABOUT, WEIGHTS, packaged_artifact
from uavrl.training.async_collector import AsyncCollector
from uavrl.training.spaces import make_spaces
from uavrl.training.sync_collector import SyncCollector
from uavrl.transforms import Mirror, NavigationReward, TraditionalReward, WalkerReward, navigation_state
from uavrl.transforms.functional import Statistic
from uavrl.transforms.observation import Angles

RewardConfig = NavigationRewardConfig | TraditionalRewardConfig


def make_device(name: str) -> torch.device:
    """Turns ``auto``, ``cpu`` or ``cuda[:i]`` into a device that exists."""
    if name == "auto":
        return torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise UavrlError(f"device must be auto, cpu, cuda or cuda:<index>, got {name!r}.") from error
    if device.type not in ("cpu", "cuda"):
        raise UavrlError(f"device must be auto, cpu, cuda or cuda:<index>, got {name!r}.")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise UavrlError(
            f"device={name} was asked for and this machine has {torch.cuda.device_count()} CUDA devices: "
            f"use device=cpu."
        )
    return device


def make_reward(config: RewardConfig | WalkerRewardConfig) -> Transform:
    """The reward transform that the configuration names."""
    if isinstance(config, NavigationRewardConfig):
        return NavigationReward(
            config.weights,
            config.flight_level,
            config.collided_reward,
            config.arrived_reward,
            config.altitude_term,  # type: ignore[arg-type]
        )
    if isinstance(config, WalkerRewardConfig):
        return WalkerReward(config.fall_reward, config.scale)
    return TraditionalReward(config.arrived_reward, config.collided_reward)


def make_env(
    env: EnvConfig | BipedalConfig,
    perception: PerceptionConfig | NoPerceptionConfig,
    reward: RewardConfig | WalkerRewardConfig | None = None,
    *,
    seed: int = 0,
    num_uavs: int | None = None,
    measure_clearance: bool = False,
    keep_cloud: bool = False,
) -> TransformedEnv:
    """The environment with everything between what it emits and what the policy and the learner read.

    The walker takes none of the keyword arguments but the seed: it walks alone.
    """
    if isinstance(env, BipedalConfig):
        rewards = [make_reward(reward)] if reward is not None else []
        return TransformedEnv(BipedalEnv(env.max_steps, seed), Compose(RewardSum(), *rewards))
    assert isinstance(perception, PerceptionConfig) and not isinstance(reward, WalkerRewardConfig)
    base = NavigationEnv(
        num_uavs or env.num_uavs,
        world=env.world,
        lidar=perception.lidar,
        airframe=env.airframe,
        aerodynamics=env.aerodynamics,
        max_steps=env.max_steps,
        goal_angle=cast(GoalAngle, env.goal_angle),
        blind=perception.blind,
        blind_to=cast(Hidden | None, perception.blind_to),
        measure_clearance=measure_clearance,
        seed=seed,
    )
    transforms = navigation_state(
        make_reward(reward) if reward is not None else None,
        radius=perception.radius,
        statistic=cast(Statistic, perception.statistic),
        flight_level=env.world.flight_level,
        angles=cast(Angles, perception.angles),
        frames=perception.frames,
        keep_cloud=keep_cloud,
    )
    return TransformedEnv(base, transforms)


def make_backward_reward(
    config: NoBackwardRewardConfig | ABRConfig | ABRPlusConfig, perception: PerceptionConfig, kept: Path
) -> BackwardReward | None:
    """The write-path transform that pays arriving flights again, or None.

    Args:
        config: which backward reward.
        perception: what the states are.
        kept: the run's copy of the artifact of ABR⁺, made here at the first time and read from then on.

    Raises:
        UavrlError: when the classifier does not fit the states, or its artifact is missing.
    """
    classifier: OneShotClassifier | TrajectoryClassifier
    if isinstance(config, ABRConfig):
        if perception.frames < 2:
            raise UavrlError(
                f"With backward_reward=abr perception.frames must be at least 2, got {perception.frames}: "
                f"it convolves over time."
            )
        classifier = OneShotClassifier(
            frames=perception.frames,
            features=10 * (perception.frames - 1),  # 20 for 3 frames (Table 4.1)
            threshold=config.threshold,
            max_classes=config.max_classes,
            seed=config.seed,
        )
    elif isinstance(config, ABRPlusConfig):
        if not kept.exists():
            source = packaged_artifact() if config.artifact == "packaged" else Path(config.artifact)
            TrajectoryClassifier.load(source)
            kept.mkdir()
            for name in (WEIGHTS, ABOUT):  # and nothing that lies beside them
                shutil.copyfile(source / name, kept / name)
        classifier = TrajectoryClassifier.load(kept)
        width = make_spaces(None, perception).state
        if classifier.inputs != width:
            raise UavrlError(
                f"The artifact {config.artifact} classifies states of {classifier.inputs} numbers, these have "
                f"{width}: make one with uavrl-pretrain from a run with perception.frames="
                f"{perception.frames}."
            )
    else:
        return None
    return BackwardReward(classifier, perception.frames, config.multiplier)


def make_buffer(
    config: UniformBufferConfig,
    device: torch.device,
    backward_reward: BackwardReward | None = None,
    *,
    frames: int = 1,
    multi_step: MultiStep | None = None,
) -> TensorDictReplayBuffer:
    """The replay buffer, uniform or prioritised (Eq. 2.17–2.18), of states that ``frames`` stacked frames make.

    The next state of an n-step transition shares no frames with its state: both are kept whole.
    """
    sampler = (
        PrioritizedSampler(config.capacity, config.alpha, config.beta)
        if isinstance(config, PrioritizedBufferConfig)
        else RandomSampler()
    )
    move = (lambda batch: batch.to(device)) if device.type != "cpu" else None
    mirror = Mirror() if config.mirror else None
    chain = (multi_step, backward_reward, mirror, move)  # writes pass from the right, samples from the left
    transforms = [transform for transform in chain if transform is not None]
    return TensorDictReplayBuffer(
        storage=FrameStorage(config.capacity, frames if multi_step is None else 1, device="cpu"),
        sampler=sampler,
        priority_key="td_error",
        transform=Compose(*transforms) if transforms else None,
    )


def make_multi_step(config: DDPGConfig) -> MultiStep | None:
    """What turns episodes into n-step transitions, or None where single steps are learned from."""
    return MultiStep(config.n_steps, config.gamma) if config.n_steps > 1 else None


def make_admission(config: UniformBufferConfig, seed: int) -> FailureBias | None:
    """What decides which episodes are stored, or None where all are."""
    if not isinstance(config, FailureBiasedBufferConfig):
        return None
    return FailureBias(config.success_return, config.probability, config.falls_per_success, seed)


def spread(vehicles: int, ratio: float) -> list[list[float]] | float:
    """What each vehicle's exploration noise is multiplied by: from 1/√ratio to √ratio, evenly in the logarithm.

    As the actors of Ape-X explore (Horgan et al. 2018, arXiv:1803.00933): some try what others would not.

    Args:
        vehicles: N.
        ratio: the largest over the smallest.

    Returns:
        ``[N, 1]`` as lists, or 1.0 where all are alike.

    Examples:
        >>> spread(3, 4.0), spread(3, 1.0)
        ([[0.5], [1.0], [2.0]], 1.0)
    """
    if vehicles == 1 or ratio == 1.0:
        return 1.0
    return [[ratio ** (i / (vehicles - 1) - 0.5)] for i in range(vehicles)]


def make_collector(
    config: TrainConfig, env: EnvBase | Callable[[], EnvBase], actor: TensorDictModuleBase, device: torch.device
) -> SyncCollector | AsyncCollector:
    """Collects whole episodes, one a batch, with exploration noise after the random steps.

    Args:
        config: the run's.
        env: the environment; for ``collector=async`` what makes it, in the process that flies.
        actor: the policy without noise.
        device: where the policy lives.
    """
    spaces = make_spaces(config.env, config.perception)
    sigma = config.algo.exploration_noise * spaces.limit
    vehicles = getattr(config.env, "num_uavs", 1)
    noise = AdditiveGaussianModule(
        spec=spaces.action_spec(device),
        sigma_init=sigma,
        sigma_end=sigma,
        annealing_num_steps=1,
        std=spread(vehicles, config.algo.exploration_spread),
        device=device,
    )
    kwargs: dict[str, Any] = {
        "policy": TensorDictSequential(actor, noise),
        "frames_per_batch": vehicles * config.collector.steps_per_batch,
        "total_frames": -1,
        "init_random_frames": config.algo.random_steps,
        "trajs_per_batch": 1,
        "traj_format": "cat",
        "policy_device": device,
        "env_device": "cpu",
        "storing_device": "cpu",
        "auto_register_policy_transforms": False,
    }
    if config.collector.name == "async":
        return AsyncCollector([env] * config.collector.processes, num_threads=config.trainer.threads, **kwargs)
    return SyncCollector(env, **kwargs)
