"""The trainer of a configuration, with all its parts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.checkpoint import Checkpoint
from torchrl.collectors import BaseCollector
from torchrl.data import RandomSampler
from torchrl.envs import Compose, EnvBase, ExcludeTransform, TransformedEnv
from torchrl.modules import AdditiveGaussianModule

import uavrl
from uavrl.buffers import BackwardReward, EpisodeBuffer, MultiStep, Windows
from uavrl.collectors.base import REQUIRED, EpisodeCollector
from uavrl.config.build import TARGET, arguments, build, find_class, options
from uavrl.config.context import CONTEXT, refuse_context
from uavrl.config.parts import STEPPER, Part
from uavrl.config.settings import TrainConfig
from uavrl.config.validation import validate
from uavrl.envs.privileged import QUANTITIES
from uavrl.envs.rules import WorldRules
from uavrl.envs.world import map_places
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import saved_sizes
from uavrl.evaluation.environment import make_device, make_env, require_keys
from uavrl.evaluation.worlds import without_variety
from uavrl.losses import ActorCriticLoss, ActorPenalty, Fork, LifeGuard, SequenceLoss
from uavrl.losses.networks import (
    NetworkSizes,
    loss_class,
    make_actor,
    make_memory,
    make_network,
    network_context,
    network_sizes,
    recurrent_shape,
)
from uavrl.models.memory import CRITIC_MEMORY, IS_INIT, RecurrentPolicy
from uavrl.policy_protocol import as_policy
from uavrl.runs.checkpoint import restore, rotation
from uavrl.runs.config import fingerprint
from uavrl.runs.episodes import EpisodeLog
from uavrl.runs.names import ARTIFACT, EPISODES
from uavrl.runs.provenance import commit
from uavrl.training.cloning import Cloning
from uavrl.training.compiled import Execution, chosen_execution
from uavrl.training.loggers import IntervalLog, make_logger
from uavrl.training.matmul import with_matmul_backend
from uavrl.training.replay import EpisodeReplay
from uavrl.training.trainer import EpisodeTrainer, barrier_seed
from uavrl.training.update import ActorCriticStepper
from uavrl.training.validation import Flier, Flight, HereFlier, ProcessFlier, Validation
from uavrl.transforms import Mirror, NavigationState
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION, Demonstrator, DemonstratorEnv
from uavrl.transforms.privileged import PRIVILEGED
from uavrl.transforms.rewards import terms_of
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.sentences import below, require

VALIDATED_TOGETHER = 10  # vehicles of a validation
CLOUD = "point_cloud"  # the key of whole scans


def build_trainer(settings: TrainConfig, config: DictConfig, run_dir: Path) -> EpisodeTrainer:
    """The trainer of a new run; a large world takes minutes."""
    device = make_device(settings.device)
    new_env = partial(make_training_env, settings, seed=barrier_seed(settings.seed, 0))
    env = new_env()
    sizes, reward_terms = network_sizes(env), terms_of(env)
    actor = make_actor(settings, sizes, device)
    loss = make_loss(settings, actor, sizes, device)
    backward_reward = make_backward_reward(settings, sizes, run_dir / ARTIFACT)
    buffer = make_buffer(settings, env, sizes, device)
    source: EnvBase | Callable[[], EnvBase] = env
    if collector_class(settings).is_remote:
        env.close()  # another process makes its own
        source = with_matmul_backend(new_env)
    taken = options({**settings.algo, TARGET: STEPPER})
    # A window is a batch in a batch, of which a recording takes no account.
    execution = "eager" if loss.learns_from_sequences else chosen_execution(settings.trainer.execution)
    logger = make_logger(
        settings.logger, run_dir, Path(settings.run_dir).name, settings.choices.get("logger", ""), settings.packages
    )
    return EpisodeTrainer(
        loss=loss,
        stepper=ActorCriticStepper(loss, **taken, execution=execution),
        cloning=make_cloning(settings, loss, sizes, execution),
        backward_reward=backward_reward,
        replay=EpisodeReplay(
            buffer, settings.algo.batch_size, settings.trainer.updates_per_step, make_windows(settings, buffer, loss)
        ),
        episode_log=EpisodeLog(run_dir / EPISODES, settings.trainer.window),
        rotation=rotation(run_dir, settings.trainer.keep_checkpoints),
        validation=make_validation(settings, config, actor, sizes),
        metadata={"fingerprint": fingerprint(config), "uavrl": uavrl.__version__, "commit": commit()},
        policy=actor,
        episodes=settings.trainer.episodes,
        steps=settings.trainer.steps,
        until_success=settings.trainer.until_success,
        learning_starts=0 if settings.demonstrated else settings.algo.learning_starts,
        stats_start=settings.algo.learning_starts if settings.demonstrated else 0,
        seed=settings.seed,
        reward_terms=reward_terms,
        checkpoint_interval=settings.trainer.checkpoint_interval,
        log=IntervalLog(logger, settings.logger.interval),
        collector=make_collector(settings, source, actor, sizes, device),  # last: it may have begun a process
    )


def make_loss(
    settings: TrainConfig, actor: TensorDictModuleBase, sizes: NetworkSizes, device: torch.device
) -> ActorCriticLoss:
    """The algorithm's loss with critics of its own, and the actor penalties around it: FORK first, LifeGuard next."""
    loss_type, packages = loss_class(settings), settings.packages
    memory = make_memory(settings, sizes) if isinstance(actor, RecurrentPolicy) else None
    more = {} if memory is None else {CRITIC_MEMORY: memory.size}
    if sizes.privileged:
        told = "td3 or sac with algo.critic_reads: choose one of them"
        require(loss_type.critics_may_differ, "algo", told, settings.algo["_target_"])
        more[PRIVILEGED] = sizes.privileged
    critic = settings.algo.critic
    if settings.algo.get("layer_norm"):  # which these critics would ignore; a preset may have set it
        require("layer_norm" in critic, "algo.layer_norm", f"false with {critic[TARGET]}, which does not take it", True)
    critics = [
        TensorDictModule(
            make_network("critic", settings, sizes, *more.values()).to(device),
            in_keys=[*more, "observation", "action"],
            out_keys=["state_action_value"],
        )
        for _ in range(loss_type.num_critics)
    ]
    written = options(settings.algo, packages, **network_context(sizes))
    refuse_context("algo", written, CONTEXT["algo"])
    acts = actor.head if isinstance(actor, RecurrentPolicy) else actor
    try:
        loss = loss_type.of_networks(acts, critics, sizes.action_spec(device), **written)
    except UavrlError as error:
        raise UavrlError(below("algo", str(error), arguments(loss_type))) from error
    given = {"gamma": settings.algo.gamma, **network_context(sizes)}
    for part in (settings.fork, settings.lifeguard, settings.actor_penalty, settings.smoothness):
        forks = part._target_ is not None and issubclass(find_class(str(part._target_), object, packages), Fork)
        told = "none with recurrent=gru or algo.critic_reads: FORK's critic reads predicted observations alone"
        require(not (more and forks), "fork", told, part._target_)
        penalized = build(part, ActorPenalty, packages=packages, base=loss, **given)  # type: ignore[type-abstract]
        if penalized is None:
            continue
        steps = settings.algo.get("n_steps", 1)
        single = penalized.learns_from_single_steps
        require(steps == 1 or not single, "algo.n_steps", f"1: {part._target_} learns from single steps", steps)
        require(
            settings.perception.get("last_action", False) or not penalized.reads_last_action,
            "perception.last_action",
            f"true: {part._target_} compares an action with the one before",
            False,
        )
        demonstrated = settings.demonstrated or DEMONSTRATOR_ACTION not in penalized.in_keys
        wanted = f"a scripted controller, such as vfh: {part._target_} learns what it would do"
        require(demonstrated, "demonstrator", wanted, None)
        trained = memory is not None and any(model.loss is not None for model in penalized.models)
        told = "another part with recurrent=gru: its models learn from single observations at each update"
        require(not trained, "actor_penalty", told, part._target_)
        loss = penalized
    if isinstance(actor, RecurrentPolicy) and memory is not None:
        loss = SequenceLoss(loss, actor.memory, memory)
    return loss.to(device)


def make_windows(settings: TrainConfig, buffer: EpisodeBuffer, loss: ActorCriticLoss) -> Windows | None:
    """What draws windows of episodes for networks with a memory; None for those without."""
    if not isinstance(loss, SequenceLoss):
        return None
    uniform = isinstance(buffer.sampler, RandomSampler)
    require(
        uniform, "buffer", "uniform with a memory: windows of episodes have no priorities", settings.buffer._target_
    )
    return Windows(loss.actor_memory.burn_in, loss.actor_memory.length, settings.algo.n_steps)


def make_cloning(
    settings: TrainConfig, loss: ActorCriticLoss, sizes: NetworkSizes, execution: Execution
) -> Cloning | None:
    """The first phase of a run, in which the actor clones the demonstrator; None where there is none."""
    part = settings.cloning
    demonstrated = settings.demonstrated or part._target_ is None
    require(demonstrated, "demonstrator", "a scripted controller, such as vfh, which cloning=dagger clones", None)
    return build(
        part, Cloning, packages=settings.packages, key="cloning", loss=loss, limit=sizes.limit, execution=execution
    )


def make_validation(
    settings: TrainConfig, config: DictConfig, actor: TensorDictModuleBase, sizes: NetworkSizes
) -> Validation | None:
    """What evaluates the policy while it trains; None where nothing does."""
    part, remote = settings.validation, collector_class(settings).is_remote
    wanted = "unseen, which measures the success rate that ends the run (trainer.until_success)"
    require(part._target_ is not None or settings.trainer.until_success is None, "validation", wanted, None)
    if part._target_ is None:
        return None
    flown = validate(without_variety(config, OmegaConf.create({"env": {}}), ()))  # as uavrl-evaluate flies it

    def new_flier(seeds: Sequence[int]) -> Flier:
        new_flight = partial(make_flight, _in_valleys(flown, seeds), sizes)
        if remote:
            return ProcessFlier(with_matmul_backend(new_flight), settings.trainer.threads)
        return HereFlier(new_flight)

    handed: dict[str, Any] = {"new_flier": new_flier, "policy": actor, "seed": settings.seed}
    return build(part, Validation, packages=settings.packages, key="validation", **handed)


def _in_valleys(settings: TrainConfig, seeds: Sequence[int]) -> TrainConfig:
    """The settings with worlds of those seeds in which the run does not train, where there is a choice of worlds."""
    world = settings.env.get("world")
    if world is None or not world.VARIES:
        return settings
    unseen = tuple(seed for seed in seeds if seed not in world.seeds)
    require(bool(unseen), "validation.seeds", "seeds of valleys in which the run does not train", list(seeds))
    return replace(settings, env=Part({**settings.env, "world": replace(world, seeds=unseen)}))


def make_flight(settings: TrainConfig, sizes: NetworkSizes) -> Flight:
    """The environment and the policy of a validation."""
    parts, state = (settings.env, settings.perception, settings.reward), recurrent_shape(settings)
    env = make_env(
        *parts,
        packages=settings.packages,
        num_uavs=VALIDATED_TOGETHER,
        recurrent_state=state,
        guards=guard_settings(settings.guards),
        measure_clearance=False,
        seed=0,
    )
    return Flight(env, make_actor(settings, sizes))


def load_risk(
    settings: TrainConfig, checkpoint: Path, device: torch.device
) -> Callable[[Tensor, Tensor], Tensor] | None:
    """The probability of a collision that a run's LifeGuard has learned; None where the run has no LifeGuard."""
    if settings.lifeguard._target_ is None:
        return None
    sizes = saved_sizes(settings)
    loss = make_loss(settings, make_actor(settings, sizes, device), sizes, device)
    restore(Checkpoint(loss_module=loss), checkpoint, ["loss_module"])
    guard = next((part for part in getattr(loss, "penalties", []) if isinstance(part, LifeGuard)), None)
    if guard is None:
        return None

    def risk(observations: Tensor, actions: Tensor) -> Tensor:
        features = torch.cat([observations[..., -guard.observations :], actions], -1).to(device)
        with torch.no_grad():
            return guard.classifier(features).sigmoid().cpu()

    return risk


def prepare_valleys(settings: TrainConfig) -> None:
    """Maps the valleys of the run here, with a progress line, for the processes that fly in them."""
    world = settings.env.get("world")
    if isinstance(world, WorldRules) and collector_class(settings).is_remote:
        map_places(world)


def make_training_env(settings: TrainConfig, *, seed: int) -> TransformedEnv:
    """The environment of a run; a scripted controller acts in it first where ``demonstrator`` names one."""
    parts, packages = (settings.env, with_stride(settings), settings.reward), settings.packages
    callable_type: Any = Callable
    acts = build(settings.demonstrator, callable_type, packages=packages)
    carried: dict[str, Any] = {
        "recurrent_state": recurrent_shape(settings),
        "critic_reads": settings.algo.get("critic_reads", ()),
        "guards": guard_settings(settings.guards),
    }
    if acts is None:
        return make_env(*parts, **carried, packages=packages, seed=seed)
    demonstrator = as_policy(acts)
    carried |= {"packages": packages, "policy_reads": demonstrator.in_keys, "seed": seed}
    reads_cloud = CLOUD in demonstrator.in_keys
    carried |= {"mark_resets": IS_INIT in demonstrator.in_keys, "keep_cloud": reads_cloud}
    env = cast(DemonstratorEnv, make_env(*parts, **carried, kind=DemonstratorEnv))
    several = math.prod(env.batch_size) > 1 and getattr(demonstrator, "one_vehicle", False)
    alone = "one that has no memory: a planner remembers scans, and demonstrates with env.num_uavs=1 alone"
    require(not several, "demonstrator", alone, type(demonstrator).__name__)
    require_keys(env, [(demonstrator.in_keys, ())], "demonstrator")
    sizes = network_sizes(env)
    env.append_transform(Demonstrator(demonstrator, demonstrator.in_keys, sizes.actions, sizes.limit))
    if reads_cloud:
        env.append_transform(ExcludeTransform(CLOUD))  # nobody else reads it, and a buffer of clouds would be huge
    env.noise = make_noise(settings, sizes, torch.device("cpu"))
    return env


def with_stride(settings: TrainConfig) -> Part:
    """The perception of a training, whose LiDAR may fire fewer rays than that of an evaluation."""
    stride, lidar = settings.trainer.lidar_stride, settings.perception.get("lidar")
    require(stride == 1 or lidar is not None, "trainer.lidar_stride", "1 with a perception without a LiDAR", stride)
    if stride == 1 or lidar is None:
        return settings.perception
    fewer = replace(lidar.device, stride=stride * lidar.device.stride)
    return Part({**settings.perception, "lidar": replace(lidar, sensor=fewer)})


def make_backward_reward(settings: TrainConfig, sizes: NetworkSizes, kept: Path) -> BackwardReward | None:
    """The write-path transform that relabels the rewards of successful episodes, or None."""
    return build(
        settings.backward_reward,
        BackwardReward,
        packages=settings.packages,
        stacked=sizes.frames,
        observations=sizes.state,
        perception=settings.perception,
        kept=kept,
    )


def _make_mirror(settings: TrainConfig) -> Mirror:
    """Shows half of what is sampled in a mirror: of our perception with folded angles alone the image is known."""
    seen = settings.perception
    ours = seen._target_ is not None and find_class(seen._target_, object, settings.packages) is NavigationState
    known = ours and seen.get("angles", "folded") == "folded"
    require(known, "buffer.mirror", "false, but with uavrl's perception and perception.angles=folded", True)
    actions = ["action", DEMONSTRATOR_ACTION] if settings.demonstrated else ["action"]
    told = {key: seen[key] for key in ("last_action", "reduction", "grid") if key in seen}
    signs: list[float] = []
    for key in settings.algo.get("critic_reads", ()):
        other = f"false, or algo.critic_reads some of {', '.join(QUANTITIES)}: no mirror image of {key} is known"
        require(key in QUANTITIES, "buffer.mirror", other, True)
        signs += QUANTITIES[key].signs
    signed = dict.fromkeys((PRIVILEGED, ("next", PRIVILEGED)), signs) if signs else {}
    return Mirror(actions=actions, motion=seen.get("motion") is not None, signed=signed, **told)


def make_buffer(settings: TrainConfig, env: EnvBase, sizes: NetworkSizes, device: torch.device) -> EpisodeBuffer:
    """The replay buffer of states that stacked frames make.

    The next state of an n-step transition shares no frames with its state: both are kept whole.
    """
    algo = settings.algo
    move = (lambda batch: batch.to(device)) if device.type != "cpu" else None
    multi_step = MultiStep(algo.n_steps, algo.gamma) if algo.n_steps > 1 else None
    mirror = _make_mirror(settings) if settings.buffer.get("mirror") else None
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
    require_keys(env, [(buffer.reads, [])], "buffer")
    return buffer


def spread(vehicles: int, ratio: float) -> list[list[float]] | float:
    """The factor of each vehicle's exploration noise: from 1/√ratio to √ratio, evenly in the logarithm.

    As the actors of Ape-X explore (Horgan et al. 2018, arXiv:1803.00933).
    """
    if vehicles == 1 or ratio == 1.0:
        return 1.0
    return [[ratio ** (i / (vehicles - 1) - 0.5)] for i in range(vehicles)]


def make_noise(settings: TrainConfig, sizes: NetworkSizes, device: torch.device) -> AdditiveGaussianModule:
    """The exploration noise, which is added to actions."""
    sigma = settings.algo.exploration_noise * sizes.limit
    return AdditiveGaussianModule(
        spec=sizes.action_spec(device),
        sigma_init=sigma,
        sigma_end=sigma,
        annealing_num_steps=1,
        std=spread(settings.env.get("num_uavs", 1), settings.algo.exploration_spread),
        device=device,
    )


def collector_class(settings: TrainConfig) -> type[EpisodeCollector]:
    """The collector's class, which must have what a run asks of it."""
    found = find_class(str(settings.collector._target_), BaseCollector, settings.packages)
    if missing := [name for name in REQUIRED if not hasattr(found, name)]:
        raise UavrlError(
            f"collector must have what uavrl's collectors have, and {found.__name__} lacks {', '.join(missing)}: "
            f"subclass one of them."
        )
    return cast(type[EpisodeCollector], found)


def make_collector(
    settings: TrainConfig,
    env: EnvBase | Callable[[], EnvBase],
    actor: TensorDictModuleBase,
    sizes: NetworkSizes,
    device: torch.device,
) -> EpisodeCollector:
    """Collects whole episodes, one a batch, with exploration noise after the random steps."""
    vehicles = settings.env.get("num_uavs", 1)
    found: Any = collector_class(settings)
    flier = torch.device("cpu") if getattr(found, "copies_policy", False) else device
    noise = make_noise(settings, sizes, flier)
    kwargs: dict[str, Any] = {
        "policy": TensorDictSequential(actor, noise),
        "frames_per_batch": vehicles * settings.collector.steps_per_batch,
        "total_frames": -1,
        "init_random_frames": settings.algo.learning_starts,
        "trajs_per_batch": 1,
        "traj_format": "cat",
        "policy_device": flier,
        "env_device": "cpu",
        "storing_device": "cpu",
        "auto_register_policy_transforms": False,
    }
    if found.is_remote:
        kwargs["num_threads"] = settings.trainer.threads
    own = options(settings.collector, settings.packages)
    refuse_context("collector", own, CONTEXT["collector"])
    return found(env, **kwargs, **own)
