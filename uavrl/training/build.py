"""The trainer of a configuration, with all its parts."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from omegaconf import DictConfig
from torchrl.envs import EnvBase

import uavrl
from uavrl.config.build import TARGET, options
from uavrl.config.parts import STEPPER
from uavrl.config.settings import TrainConfig
from uavrl.runs.checkpoint import rotation
from uavrl.runs.config import fingerprint
from uavrl.runs.episodes import EpisodeLog
from uavrl.runs.names import ARTIFACT, EPISODES
from uavrl.runs.provenance import commit
from uavrl.training.actor_and_loss import make_actor, make_loss
from uavrl.training.arithmetic import carried
from uavrl.training.compiled_updates import chosen_execution
from uavrl.training.experience import Experience
from uavrl.training.factory import (
    collector_class,
    make_backward_reward,
    make_buffer,
    make_collector,
    make_device,
    make_training_env,
)
from uavrl.training.loggers import IntervalLog, make_logger
from uavrl.training.network_sizes import network_sizes
from uavrl.training.stepper import ActorCriticStepper
from uavrl.training.trainer import EpisodeTrainer, barrier_seed
from uavrl.transforms.rewards import terms_of


def build_trainer(settings: TrainConfig, config: DictConfig, run_dir: Path) -> EpisodeTrainer:
    """All that a run learns with, new; a large world takes minutes."""
    device = make_device(settings.device)
    new_env = partial(make_training_env, settings, seed=barrier_seed(settings.seed, 0))
    env = new_env()
    sizes, reward_terms = network_sizes(env), terms_of(env)
    actor = make_actor(settings, sizes, device)
    loss = make_loss(settings, actor, sizes, device)
    backward_reward = make_backward_reward(settings, sizes, run_dir / ARTIFACT)
    buffer = make_buffer(settings, env, sizes, device)
    flown: EnvBase | Callable[[], EnvBase] = env
    if collector_class(settings).flies_elsewhere:
        env.close()  # another process makes its own
        flown = carried(new_env)
    taken = options({**settings.algo, TARGET: STEPPER})
    logger = make_logger(settings.logger, run_dir, settings.choices.get("logger", ""), settings.packages)
    return EpisodeTrainer(
        loss=loss,
        stepper=ActorCriticStepper(loss, **taken, execution=chosen_execution(settings.trainer.execution)),
        backward_reward=backward_reward,
        experience=Experience(buffer, settings.algo.batch_size, settings.trainer.updates_per_step),
        episode_log=EpisodeLog(run_dir / EPISODES, settings.trainer.window),
        rotation=rotation(run_dir, settings.trainer.keep_checkpoints),
        metadata={"fingerprint": fingerprint(config), "uavrl": uavrl.__version__, "commit": commit()},
        policy=actor,
        episodes=settings.trainer.episodes,
        steps=settings.trainer.steps,
        until_success=settings.trainer.until_success,
        learns_after=0 if settings.guided else settings.algo.random_steps,
        judged_after=settings.algo.random_steps if settings.guided else 0,
        seed=settings.seed,
        reward_terms=reward_terms,
        checkpoint_interval=settings.trainer.checkpoint_interval,
        log=IntervalLog(logger, settings.logger.interval),
        collector=make_collector(settings, flown, actor, sizes, device),  # last: it may have begun a process
    )
