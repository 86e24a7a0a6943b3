"""Environment, buffer and collector of a configuration."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import BaseCollector
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv
from torchrl.modules import AdditiveGaussianModule

from uavrl.buffers import BackwardReward, EpisodeBuffer, MultiStep
from uavrl.config.build import build, find_class, options
from uavrl.config.context import CONTEXT, refuse_context
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl.training.collecting import OURS, FlightCollector
from uavrl.training.guided import GUIDE_ACTION, Guidance, GuidedEnv
from uavrl.training.network_sizes import NetworkSizes, inner_transforms, network_sizes
from uavrl.transforms import Mirror, PointCloudReduction


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


def make_env(
    env: Mapping[str, Any],
    perception: Mapping[str, Any],
    reward: Mapping[str, Any] | None = None,
    *,
    packages: Iterable[str] = (),
    num_uavs: int | None = None,
    keep_cloud: bool = False,
    kind: type[TransformedEnv] = TransformedEnv,
    **context: Any,
) -> TransformedEnv:
    """The environment with everything between what it emits and what the policy and the learner read."""
    several = {} if num_uavs is None else {"num_uavs": num_uavs}  # in place of those that a run flies
    seen = {key: value for key, value in perception.items() if key not in CONTEXT["env"]}
    own = {**seen, **env, **several}
    base = build(own, EnvBase, packages=packages, key="env", **context)
    if base is None:
        raise UavrlError("env must name an environment, got null: choose one with env=NAME.")
    made = kind(base, Compose())
    state = build(perception, Transform, packages=packages)
    for part in state.modules() if keep_cloud and state is not None else ():
        if isinstance(part, PointCloudReduction):
            part.del_keys = False
    paid = None if reward is None else build(reward, Transform, packages=packages)
    for transform, part in ((state, "perception"), (paid, "reward")):
        if transform is not None:
            _require_keys(made, [(inner.in_keys, inner.out_keys) for inner in inner_transforms(transform)], part)
            made.append_transform(transform)
    _require_keys(made, [(["observation"], [])], "policy")
    return made


def make_training_env(settings: TrainConfig, *, seed: int) -> TransformedEnv:
    """The environment that a run flies in; a guide's, where one flies its first steps."""
    parts, packages = (settings.env, settings.perception, settings.reward), settings.packages
    anything_that_is_called: Any = Callable
    guide = build(settings.guide, anything_that_is_called, packages=packages)
    if guide is None:
        return make_env(*parts, packages=packages, seed=seed)
    env = cast(GuidedEnv, make_env(*parts, packages=packages, seed=seed, kind=GuidedEnv))
    _require_keys(env, [(getattr(guide, "in_keys", ()), ())], "guide")
    sizes = network_sizes(env)
    env.append_transform(Guidance(guide, getattr(guide, "in_keys", ()), sizes.actions))
    env.noise = make_noise(settings, sizes, torch.device("cpu"))
    return env


def _require_keys(env: EnvBase, steps: Iterable[tuple[Iterable[Any], Iterable[Any]]], reader: str) -> None:
    """Refuses what reads more than an environment emits, each step also what the steps before it have written."""
    specs = (env.observation_spec, env.full_reward_spec, env.full_done_spec, env.full_action_spec)
    emitted = {key for spec in specs for key in spec.keys(True, True)}
    for read, written in steps:
        for key in read:
            if key not in emitted:
                raise UavrlError(
                    f"The {reader} reads {key!r}, which {type(env.base_env).__name__} does not emit: choose an env, a "
                    f"perception and a reward that go together."
                )
        emitted.update(written)


def make_backward_reward(settings: TrainConfig, sizes: NetworkSizes, kept: Path) -> BackwardReward | None:
    """The write-path transform that pays arriving flights again, or None."""
    return build(
        settings.backward_reward,
        BackwardReward,
        packages=settings.packages,
        stacked=sizes.frames,
        observations=sizes.state,
        perception=settings.perception,
        kept=kept,
    )


def make_buffer(settings: TrainConfig, env: EnvBase, sizes: NetworkSizes, device: torch.device) -> EpisodeBuffer:
    """The replay buffer of states that stacked frames make.

    The next state of an n-step transition shares no frames with its state: both are kept whole.
    """
    algo = settings.algo
    move = (lambda batch: batch.to(device)) if device.type != "cpu" else None
    multi_step = MultiStep(algo.n_steps, algo.gamma) if algo.n_steps > 1 else None
    seen = {key: settings.perception[key] for key in ("last_action", "reduction") if key in settings.perception}
    actions = ["action", GUIDE_ACTION] if settings.guided else ["action"]
    mirror = Mirror(actions=actions, **seen) if settings.buffer.get("mirror") else None
    chain = (multi_step, mirror, move)  # writes pass from the right, samples from the left
    transforms = [transform for transform in chain if transform is not None]
    buffer = build(
        settings.buffer,
        EpisodeBuffer,
        packages=settings.packages,
        frames=sizes.frames if multi_step is None else 1,
        seed=settings.seed,
        transform=Compose(*transforms) if transforms else None,
    )
    if buffer is None:
        raise UavrlError("buffer must name a replay buffer, got null: choose one with buffer=NAME.")
    _require_keys(env, [(buffer.reads, [])], "buffer")
    return buffer


def spread(vehicles: int, ratio: float) -> list[list[float]] | float:
    """What each vehicle's exploration noise is multiplied by: from 1/√ratio to √ratio, evenly in the logarithm.

    As the actors of Ape-X explore (Horgan et al. 2018, arXiv:1803.00933): some try what others would not.
    """
    if vehicles == 1 or ratio == 1.0:
        return 1.0
    return [[ratio ** (i / (vehicles - 1) - 0.5)] for i in range(vehicles)]


def make_noise(settings: TrainConfig, sizes: NetworkSizes, device: torch.device) -> AdditiveGaussianModule:
    """What is added to actions to explore."""
    sigma = settings.algo.exploration_noise * sizes.limit
    return AdditiveGaussianModule(
        spec=sizes.action_spec(device),
        sigma_init=sigma,
        sigma_end=sigma,
        annealing_num_steps=1,
        std=spread(settings.env.get("num_uavs", 1), settings.algo.exploration_spread),
        device=device,
    )


def collector_class(settings: TrainConfig) -> type[FlightCollector]:
    """The class of the run's collector."""
    found = find_class(str(settings.collector._target_), BaseCollector, settings.packages)
    if missing := [name for name in OURS if not hasattr(found, name)]:
        raise UavrlError(
            f"collector must have what uavrl's collectors have, and {found.__name__} lacks {', '.join(missing)}: "
            f"subclass one of them."
        )
    return cast(type[FlightCollector], found)


def make_collector(
    settings: TrainConfig,
    env: EnvBase | Callable[[], EnvBase],
    actor: TensorDictModuleBase,
    sizes: NetworkSizes,
    device: torch.device,
) -> FlightCollector:
    """Collects whole episodes, one a batch, with exploration noise after the random steps."""
    vehicles = settings.env.get("num_uavs", 1)
    found: Any = collector_class(settings)
    flier = torch.device("cpu") if getattr(found, "flies_copies", False) else device
    noise = make_noise(settings, sizes, flier)
    kwargs: dict[str, Any] = {
        "policy": TensorDictSequential(actor, noise),
        "frames_per_batch": vehicles * settings.collector.steps_per_batch,
        "total_frames": -1,
        "init_random_frames": settings.algo.random_steps,
        "trajs_per_batch": 1,
        "traj_format": "cat",
        "policy_device": flier,
        "env_device": "cpu",
        "storing_device": "cpu",
        "auto_register_policy_transforms": False,
    }
    if found.flies_elsewhere:
        kwargs["num_threads"] = settings.trainer.threads
    own = options(settings.collector)
    refuse_context("collector", own, CONTEXT["collector"])
    return found(env, **kwargs, **own)
