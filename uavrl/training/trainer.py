"""TorchRL's Trainer, fed with whole episodes and able to resume bit by bit."""

from __future__ import annotations

import math
import time
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import Checkpoint, CheckpointRotation
from torchrl.data import ReplayBuffer
from torchrl.record.loggers import Logger
from torchrl.trainers import Trainer, TrainerHookBase

from uavrl.buffers import BackwardReward, FailureBias
from uavrl.errors import UavrlError
from uavrl.losses import ActorCriticLoss
from uavrl.runs.checkpoint import BufferState, RandomState
from uavrl.runs.episodes import EpisodeLog, split_episodes, summarize
from uavrl.runs.files import naming, require_room
from uavrl.training.async_collector import AsyncCollector
from uavrl.training.progress import Progress
from uavrl.training.silence import Silence
from uavrl.training.stepper import ActorCriticStepper
from uavrl.training.stopping import Stop
from uavrl.training.sync_collector import SyncCollector

# What a learner reads; everything else that the environment emits is for metrics.
STORED_KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "arrived"),
    ("next", "collided"),
)

WAITED_FOR = (
    "No episode has ended for a while: flights go on for up to env.max_steps steps, or the updates after one are being "
    "made, trainer.updates_per_step for each of its steps; the first ones are compiled."
)


def barrier_seed(seed: int, episodes: int) -> int:
    """The environment's seed after the checkpoint made at this number of episodes."""
    return int(np.random.SeedSequence([seed, episodes]).generate_state(1)[0])


class EpisodeReplay(TrainerHookBase):
    """Stores whole episodes and samples batches: after an episode of T steps come T updates.

    Where every transition is as likely as the next, ``BATCHES_AT_ONCE`` batches are drawn in one call.

    Args:
        buffer: where transitions are stored.
        batch_size: transitions in a batch.
        updates_per_step: updates for each environment step.
        admission: what decides which episodes are stored; None stores all.
        updates_when_left_out: updates of all but actor and targets after an episode that is not stored.
    """

    BATCHES_AT_ONCE = 32

    def __init__(
        self,
        buffer: ReplayBuffer,
        batch_size: int,
        updates_per_step: float = 1.0,
        *,
        admission: FailureBias | None = None,
        updates_when_left_out: int = 0,
    ) -> None:
        self.buffer = buffer
        self.batch_size = batch_size
        self.updates_per_step = updates_per_step
        self.admission = admission
        self.updates_when_left_out = updates_when_left_out
        self._trainer: Trainer | None = None
        self._owed = 0.0
        self._drawn: list[TensorDictBase] = []
        self._to_draw = 0

    def extend(self, batch: TensorDictBase) -> None:
        """Writes the episodes and sets how many updates follow."""
        assert self._trainer is not None
        if self.admission is not None:
            stored = [episode for episode in split_episodes(batch) if self.admission.admits(episode)]
            cast(ActorCriticStepper, self._trainer.optimization_stepper).actor_learns = bool(stored)
            batch = torch.cat(stored) if stored else batch[:0]
        if len(batch):
            self.buffer.extend(batch.select(*STORED_KEYS))
            self._owed += len(batch) * self.updates_per_step
        elif len(self.buffer):
            self._owed += self.updates_when_left_out
        self._trainer.optim_steps_per_batch = self._to_draw = int(self._owed)
        self._owed -= int(self._owed)

    def sample(self, batch: TensorDictBase) -> TensorDictBase:
        """One batch of transitions."""
        if self.prioritized:  # each update changes what the next one should draw
            return self.buffer.sample(self.batch_size)
        if not self._drawn:
            count = min(self.BATCHES_AT_ONCE, self._to_draw)
            self._drawn = list(self.buffer.sample(count * self.batch_size).split(self.batch_size))[::-1]
        self._to_draw -= 1
        return self._drawn.pop()

    @property
    def prioritized(self) -> bool:
        """Whether the buffer's sampler follows priorities."""
        return hasattr(self.buffer.sampler, "alpha")

    def draw(self, count: int) -> TensorDictBase:
        """``count`` transitions, each as likely as the next whatever the sampler."""
        return self.buffer[torch.randint(len(self.buffer), (count,))]

    def update_priority(self, batch: TensorDictBase) -> None:
        """Hands the new priorities to a prioritised sampler."""
        self.buffer.update_tensordict_priority(batch)

    def state_dict(self) -> dict[str, Any]:
        """The fraction of an update still owed, and what the admission counts."""
        return {"owed": self._owed} | ({} if self.admission is None else {"admission": self.admission.state_dict()})

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._owed = state_dict["owed"]
        if self.admission is not None:
            self.admission.load_state_dict(state_dict["admission"])

    def register(self, trainer: Trainer, name: str = "episode_replay") -> None:
        """Hooks extending, sampling and priorities into the trainer."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("batch_process", self.extend)
        trainer.register_op("process_optim_batch", self.sample)
        if self.prioritized:
            trainer.register_op("post_optim_log", self.update_priority)


class EpisodeTrainer(Trainer):
    """Trains until ``episodes`` are flown, or enough of the last ones arrive; every checkpoint is a barrier.

    When a checkpoint is due, the open flights end and are learned from; what begins meanwhile is dropped whatever its
    end. Then no flight is open that counts, and the environment is built anew from a seed that depends on the run's
    seed and the number of episodes alone. A resumed process passes the same barrier, so that its run is bit-identical
    to one that was never stopped.

    Args:
        collector: yields one whole episode a batch, and knows when those that count have ended.
        loss: the loss module.
        stepper: the optimisation step.
        replay: where episodes are stored.
        backward_reward: what relabels them on the way there, if anything does.
        episode_log: where episodes are recorded.
        progress: what the user sees.
        rotation: where checkpoints go.
        metadata: goes into each checkpoint's manifest.
        policy: the actor, kept as a component of its own for evaluation.
        episodes: when to stop.
        until_success: the share of the last ``episode_log.window`` flights that ends the training before; None: never.
        seed: the run's seed.
        checkpoint_interval: steps of whole episodes after which a checkpoint is due.
        logger: TorchRL logger.
        log_interval: steps between logged values.
    """

    def __init__(
        self,
        *,
        collector: SyncCollector | AsyncCollector,
        loss: ActorCriticLoss,
        stepper: ActorCriticStepper,
        replay: EpisodeReplay,
        backward_reward: BackwardReward | None,
        episode_log: EpisodeLog,
        progress: Progress,
        rotation: CheckpointRotation,
        metadata: dict[str, Any],
        policy: torch.nn.Module,
        episodes: int,
        until_success: float | None = None,
        seed: int,
        checkpoint_interval: int,
        logger: Logger | None,
        log_interval: int,
    ) -> None:
        self.episode_log = episode_log
        self.backward_reward = backward_reward
        self.admission = replay.admission
        self._buffer = replay.buffer
        self.progress = progress
        self.run_seed = seed
        self._last_save = 0
        self.steps_flown = 0
        self.stop = Stop()
        self.episodes = episodes
        self.until_success = until_success
        self.seconds_before = 0.0  # that earlier processes of this run have trained
        self._began = time.monotonic()
        super().__init__(
            collector=collector,
            total_frames=2**62,
            frame_skip=1,
            optim_steps_per_batch=0,
            loss_module=loss,
            optimization_stepper=stepper,
            logger=logger,
            progress_bar=False,
            save_trainer_interval=checkpoint_interval,
            log_interval=log_interval,
            checkpoint=Checkpoint(
                policy=policy,
                replay_data=BufferState(replay.buffer),
                episode_log=episode_log,
                random_state=RandomState(),
                **({} if backward_reward is None else {"backward_reward": backward_reward}),
                format="archive",
                archive_compression="stored",
            ),
            checkpoint_rotation=rotation,
            checkpoint_metadata=lambda _: {**metadata, "episodes": episode_log.count, "seconds": self.seconds},
        )
        replay.register(self)
        self._silence = Silence(WAITED_FOR)
        self.register_op("batch_process", lambda batch: stepper.observe(batch, replay.draw))
        self.register_op("pre_steps_log", self._record)
        self.register_op("post_optim_complete_log", self._check_losses)

    @property
    def seconds(self) -> float:
        """Wall-clock time that the run has trained for, in all its processes; what a resume drops left out."""
        return self.seconds_before + time.monotonic() - self._began

    @property
    def finished(self) -> bool:
        """Whether enough episodes are flown, or enough of the last ones arrived."""
        log = self.episode_log
        trained = self.until_success is not None and log.rates()["arrived"] >= self.until_success
        return log.count >= self.episodes or (trained and log.count >= log.window)

    def train(self) -> None:
        """Trains, and says what is waited for where no episode ends for long."""
        with self._silence:
            super().train()

    def _save_trainer(self) -> None:
        folder = self.checkpoint_rotation.directory
        with naming(folder):
            require_room(folder.parent, 2 * self._checkpoint_size())  # files, then the archive of them
            super()._save_trainer()

    def _checkpoint_size(self) -> float:
        """About how many bytes a checkpoint takes: the networks, Adam's moments of them, and the transitions."""
        networks = sum(getattr(value, "nbytes", 0) for value in self.loss_module.state_dict().values())
        return 3 * networks + self._buffer.storage.frame_bytes + 80 * len(self._buffer)

    def _record(self, batch: TensorDictBase) -> dict[str, float]:
        """Writes the episodes of a batch, shows progress and ends the training when enough are flown."""
        self._silence.heard()
        steps = self.collected_frames - len(batch)
        for trajectory in split_episodes(batch):
            steps += len(trajectory)
            episode = summarize(trajectory, self.episode_log.count + 1, steps)
            self.episode_log.add(episode)
        rates, mean_return = self.episode_log.rates(), self.episode_log.mean_return()
        self.progress.update(self.episode_log.count, self.collected_frames, rates, mean_return)
        if self.finished:
            self.request_stop(f"{self.episode_log.count} episodes are flown")
        return {
            "minutes": self.seconds / 60,
            **{f"rate_{k}": v for k, v in rates.items()},
            "return": mean_return,
            "episodes": self.episode_log.count,
            **self.optimization_stepper.diagnostics(),
            **(self.backward_reward.diagnostics() if self.backward_reward is not None else {}),
            **(self.admission.diagnostics() if self.admission is not None else {}),
        }

    @staticmethod
    def _check_losses(updates: int, losses: TensorDictBase | None) -> None:
        if losses is not None and not math.isfinite(losses["loss_value"].item()):
            raise UavrlError(
                f"The critic's loss became {losses['loss_value'].item()} after {updates} updates: "
                f"lower the learning rates; the last checkpoint is untouched."
            )

    def barrier(self) -> None:
        """Builds the environment anew; flights in a process of their own go on."""
        count = self.episode_log.count
        self.steps_flown = self.collector.state_dict()["frames"]
        self.collector.start_anew(barrier_seed(self.run_seed, count), self.episodes - count)
        self.stop.begin()

    def save_trainer(self, force_save: bool = False) -> None:
        """Writes a checkpoint, behind a barrier, once the flights have ended that were open when it became due.

        A run that was asked to stop goes on to its next checkpoint where that comes soon: one more would change what
        is flown after it. Flights in a process of their own never come again, and are saved at once.
        """
        steps = self.collected_frames - self._last_save
        anywhere = isinstance(self.collector, AsyncCollector)
        self.stop.foretell(0 if anywhere else self.save_trainer_interval - steps, steps)
        due = steps >= self.save_trainer_interval or (anywhere and self.stop.signal is not None)
        if force_save or (due and self.collector.wind_down()):
            self._last_save = self.collected_frames
            with self.stop.behind_this():
                self.barrier()
                self._save_trainer()
