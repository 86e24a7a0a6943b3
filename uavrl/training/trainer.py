"""The loop of a run: Algorithm 3.1, able to stop at any checkpoint and to go on bit by bit."""

import logging
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import Checkpoint, CheckpointRotation

from uavrl.buffers import BackwardReward
from uavrl.collectors.base import EpisodeCollector
from uavrl.collectors.stall_notice import StallNotice
from uavrl.errors import FlyingEnded, UavrlError, ValidationFailed
from uavrl.losses import ActorCriticLoss
from uavrl.runs.checkpoint import BufferState, RandomState
from uavrl.runs.episodes import EpisodeLog, split_episodes, summarize
from uavrl.runs.interrupts import Stop
from uavrl.training.cloning import Cloning
from uavrl.training.loggers import IntervalLog
from uavrl.training.progress import Progress
from uavrl.training.replay import EpisodeReplay
from uavrl.training.update import ActorCriticStepper
from uavrl.training.validation import Validation
from uavrl.transforms.rewards import RewardTerms
from uavrl_onboard.files import naming, require_room
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)
WAITED_FOR = "No episode has ended for a while: one takes up to env.max_steps steps"
UPDATES = (
    "or the updates after one are being made, trainer.updates_per_step for each of its steps; the first are compiled"
)


def waited_for(steps: int, learning_starts: int, stats_start: int) -> str:
    """What a run waits for in which no episode has ended for a while.

    Args:
        steps: of whole episodes, so far.
        learning_starts: steps before which actions are random and nothing is learned.
        stats_start: steps until which a scripted controller acts, whose episodes are learned from.
    """
    if steps < learning_starts:
        return f"{WAITED_FOR}, random ones until step {learning_starts:,}, before which no updates are made."
    demonstrated = f" The scripted controller acts until step {stats_start:,}, and its episodes are learned from, too."
    return f"{WAITED_FOR}, {UPDATES}." + (demonstrated if steps < stats_start else "")


def barrier_seed(seed: int, episodes: int) -> int:
    """The environment's seed after the checkpoint made at this number of episodes."""
    return int(np.random.SeedSequence([seed, episodes]).generate_state(1)[0])


@dataclass(kw_only=True, eq=False)
class EpisodeTrainer:
    """Trains until there are enough episodes, steps or successes; every checkpoint is a barrier.

    When a checkpoint is due, the open episodes end and are learned from; what begins meanwhile is dropped whatever its
    end. Then the environment is built anew from a seed that depends on the run's seed and the number of episodes alone.
    A resumed process passes the same barrier, so that its run is bit-identical to one that was never stopped.
    """

    collector: EpisodeCollector  # yields one whole episode a batch
    policy: torch.nn.Module  # the actor, kept as a component of its own for evaluation
    loss: ActorCriticLoss
    stepper: ActorCriticStepper
    replay: EpisodeReplay
    backward_reward: BackwardReward | None
    episode_log: EpisodeLog
    log: IntervalLog
    rotation: CheckpointRotation  # where checkpoints go
    metadata: dict[str, Any]  # goes into each checkpoint's manifest
    episodes: int
    steps: int | None  # of whole episodes, which end the training before
    until_success: float | None  # the success rate of ``validation`` that ends the training before
    learning_starts: int  # steps
    stats_start: int  # steps; episodes that ended before are a scripted controller's
    seed: int
    checkpoint_interval: int  # steps of whole episodes after which a checkpoint is due
    cloning: Cloning | None = None  # the first phase, if there is one
    validation: Validation | None = None  # measures the policy's success in unseen valleys meanwhile
    reward_terms: RewardTerms | None = None  # the named terms of the reward
    progress: Progress = field(default_factory=lambda: Progress(0, 1, enabled=False))
    stop: Stop = field(default_factory=Stop)
    collected_frames: int = 0  # steps of whole episodes, which is what is learned from
    steps_flown: int = 0  # with those dropped while others ended
    seconds_before: float = 0.0  # that earlier processes of this run have trained
    reached: bool = field(default=False, init=False)  # whether the policy has exceeded ``until_success``

    def __post_init__(self) -> None:
        """Sets out what a checkpoint holds."""
        self._last_save = 0
        self._began = time.monotonic()
        self._stall_notice = StallNotice(self._waited_for)
        optional = {"backward_reward": self.backward_reward, "cloning": self.cloning}
        self.checkpoint = Checkpoint(
            policy=self.policy,
            loss_module=self.loss,
            stepper=self.stepper,
            collector=self.collector,
            replay=self.replay,
            replay_data=BufferState(self.replay.buffer),
            **{name: part for name, part in optional.items() if part is not None},
            episode_log=self.episode_log,
            log=self.log,
            trainer=self,
            random_state=RandomState(),
            format="archive",
            archive_compression="stored",
        )

    def train(self) -> None:
        """Chansuparp (2022), Algorithm 3.1, for whole episodes: those of N vehicles end one after the other."""
        with self._stall_notice, self._kept():  # says what is waited for where no episode ends for long
            for episode in self.collector:  # a_t = clip(μ(s_t) + ε, a_low, a_high) until d_t
                self.collected_frames += len(episode)
                stored = self.replay.filtered(episode)
                if self.backward_reward is not None:
                    stored = self.backward_reward.inv(stored)  # r += m P_addReward, after a success
                updates = self.replay.store(stored)
                self.stepper.observe(episode, self.replay.draw)  # the classifier c learns
                self.record(episode)
                if self.cloning is not None and not self.cloning.finished:
                    self.clone(self.cloning)
                elif self.collected_frames >= self.learning_starts:
                    self.learn(updates, actor=len(stored) > 0)
                if self.validation is not None and not self.finished:
                    self.validate(self.validation)
                if self.finished:
                    self.save()
                    break
                self.save_if_due()

    def _waited_for(self) -> str:
        return waited_for(self.collected_frames, self.learning_starts, self.stats_start)

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Saves what was learned when processes that fly have died, or a validation has failed."""
        try:
            yield
        except (FlyingEnded, ValidationFailed):
            if self.collected_frames > self._last_save:
                self._last_save = self.collected_frames
                self._write()
            raise

    def clone(self, cloning: Cloning) -> None:
        """Updates the actor towards the demonstrator's actions, on random states flown so far."""
        due = cloning.due(self.collected_frames) if len(self.replay.buffer) else 0  # a filter may keep none at first
        batches = self.replay.batches(due, cloning.batch_size)
        if (loss := cloning.learn(batches, self.collected_frames)) is not None:
            self._require_finite(loss, "The distance to the demonstrator", cloning.updates)
            self.log.add({"loss_cloning": loss}, self.collected_frames)

    def warm_up(self, updates: int) -> None:
        """Lets the critics learn what the cloned policy is worth, before the actor learns from them."""
        if not updates:
            return
        log.info("The critics learn from what was flown so far (%s), before the actor does.", f"{updates:,} updates")
        losses = []
        for batch in self.replay.batches(updates):
            losses.append(self.stepper.warm_up(batch))
            self._stall_notice.reset()  # the line above tells what is waited for
        self._require_finite(torch.stack(losses).mean().item(), "The critic's loss", updates)

    def learn(self, updates: int, *, actor: bool) -> None:
        """Updates critics and models, and every so many times the actor and the targets, on random batches."""
        if self.cloning is not None and updates and not self.stepper.updates:
            self.warm_up(self.cloning.critic_updates)
        self.stepper.actor_learns = actor
        losses: TensorDictBase | None = None
        for done, batch in enumerate(self.replay.batches(updates)):
            new = self.stepper.step(None, batch)
            self.replay.update_priority(batch)
            losses = new if losses is None else losses * done / (done + 1) + new / (done + 1)  # their mean
        if losses is None:
            return
        self._require_finite(losses["loss_value"].item(), "The critic's loss", self.stepper.updates)
        self.log.add({"optim_steps": self.stepper.updates, **losses}, self.collected_frames)

    def validate(self, validation: Validation) -> None:
        """Takes in a validation that has ended, and begins one that is due."""
        if (found := validation.advance(self.collected_frames, self.until_success)) is None:
            return
        self._stall_notice.reset()
        self.progress.validated = str(found)
        self.log.add({"success_unseen": found.rate}, found.steps)
        self._judge(validation)
        if self.reached:
            log.info(
                "The policy has exceeded a success rate of %g %% in unseen valleys in at least one validation, so the "
                "run ends. If it never had, it would end so with a probability of at most %g. The last validation: %s.",
                100 * (self.until_success or 0),
                validation.error,
                found,
            )

    def _judge(self, validation: Validation) -> None:
        """Decide whether the policy exceeds the success rate that ends the training, after each new validation."""
        self.reached = self.until_success is not None and validation.reached(self.until_success)

    def _require_finite(self, value: float, name: str, updates: int) -> None:
        if not math.isfinite(value):
            raise UavrlError(
                f"{name} became {value} after {pluralize(updates, 'update')}: lower the learning rates; the last "
                f"checkpoint is untouched."
            )

    def record(self, batch: TensorDictBase) -> None:
        """Writes the episodes of a batch to ``episodes.csv``, the progress line and the logger."""
        self._stall_notice.reset()
        steps = self.collected_frames - len(batch)
        for trajectory in split_episodes(batch):
            steps += len(trajectory)
            self.episode_log.add(summarize(trajectory, self.episode_log.count + 1, steps, self.reward_terms))
        rates, mean_return = self.episode_log.rates(), self.episode_log.mean_return()
        self.progress.update(self.episode_log.count, self.collected_frames, rates, mean_return)
        values = {
            "minutes": self.seconds / 60,
            **{f"rate_{name}": rate for name, rate in rates.items()},
            "return": mean_return,
            **{f"return_{name}": mean for name, mean in self.episode_log.mean_terms().items()},
            "episodes": self.episode_log.count,
        }
        for part in (self.stepper, self.backward_reward, self.replay):
            values |= {} if part is None else part.diagnostics()
        self.log.add(values, self.collected_frames)

    @property
    def updates(self) -> int:
        """How often the actor cloned the demonstrator, and critics or models were updated."""
        return self.stepper.updates + (0 if self.cloning is None else self.cloning.updates)

    @property
    def seconds(self) -> float:
        """Wall-clock time that the run has trained for, in all its processes; what a resume drops left out."""
        return self.seconds_before + time.monotonic() - self._began

    @property
    def finished(self) -> bool:
        """Whether there are enough episodes or steps, or the policy is good enough."""
        enough = self.steps is not None and self.collected_frames >= self.steps
        return enough or self.episode_log.count >= self.episodes or self.reached

    def save_if_due(self) -> None:
        """Saves once the episodes have ended that were open when a checkpoint became due.

        A run that was asked to stop goes on to its next checkpoint where that comes soon: one more would change what
        comes after it. Episodes of another process never come again, and are saved at once.
        """
        steps = self.collected_frames - self._last_save
        anywhere = self.collector.is_remote
        self.stop.set_time_to_checkpoint(0 if anywhere else self.checkpoint_interval - steps, steps)
        due = steps >= self.checkpoint_interval or (anywhere and self.stop.signal is not None)
        if due and self.collector.drain():
            self.save()

    def save(self) -> None:
        """Writes a checkpoint, behind a barrier."""
        self._last_save = self.collected_frames
        with self.stop.deferred():
            self.barrier()
            self._write()

    def barrier(self) -> None:
        """Builds the environment anew; episodes in another process go on."""
        count = self.episode_log.count
        self.steps_flown = self.collector.state_dict()["frames"]
        self.collector.restart(barrier_seed(self.seed, count), self.episodes - count)
        self.stop.begin()

    def _write(self) -> None:
        progress = {
            "episodes": self.episode_log.count,
            "seconds": self.seconds,
            "collected_frames": self.collected_frames,
        }
        with naming(self.rotation.directory):
            self.log.flush()
            require_room(self.rotation.directory.parent, 2 * self._checkpoint_size())  # files, then the archive of them
            self.rotation.save(self.checkpoint, step=self.collected_frames, metadata=self.metadata | progress)

    def _checkpoint_size(self) -> float:
        """About how many bytes a checkpoint takes: the networks, Adam's moments of them, and the transitions."""
        networks = sum(getattr(value, "nbytes", 0) for value in self.loss.state_dict().values())
        return 3 * networks + self.replay.buffer.storage.frame_bytes + 80 * len(self.replay.buffer)

    def state_dict(self) -> dict[str, Any]:
        """How far the run has come, and how well its policy did in unseen valleys, if that was measured."""
        validation = {} if self.validation is None else {"validation": self.validation.state_dict()}
        return {"collected_frames": self.collected_frames, "last_save": self._last_save, **validation}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.collected_frames, self._last_save = state_dict["collected_frames"], state_dict["last_save"]
        if self.validation is not None and "validation" in state_dict:  # a run may go on with or without one
            self.validation.load_state_dict(state_dict["validation"])
            self._judge(self.validation)
