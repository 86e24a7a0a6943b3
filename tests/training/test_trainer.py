"""What stands in the replay buffer, when the networks are updated, and what a barrier does."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from tests.helpers.runs import LIFEGUARD, small_config
from uavrl.collectors.stall_notice import StallNotice
from uavrl.config import validate
from uavrl.envs.world import World
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import load_actor
from uavrl.losses import LifeGuard
from uavrl.runs.episodes import Episode, read_episodes
from uavrl.training.build import build_trainer
from uavrl.training.run import create_run, seed_everything, train
from uavrl.training.trainer import EpisodeTrainer, barrier_seed

# The policy hardly moves, and no checkpoint comes between the first and the last.
FROZEN = ["algo.actor_lr=1e-12", "algo.critic_lr=1e-12", "trainer.checkpoint_interval=100000", "buffer.capacity=2000"]


@dataclass
class Run:
    """A finished tiny training: its trainer, its episodes and the updates made after each of them."""

    trainer: EpisodeTrainer
    episodes: list[Episode]
    updates: list[int]

    @property
    def stored(self) -> TensorDictBase:
        buffer = self.trainer.replay.buffer
        return buffer.storage.get(slice(0, len(buffer)))

    def stored_episodes(self) -> list[TensorDictBase]:
        return list(self.stored.split([e.steps for e in self.episodes]))


def built(run_dir: Path, *overrides: str) -> EpisodeTrainer:
    config = small_config(run_dir, *overrides)
    settings = validate(config)
    seed_everything(settings.seed)
    return build_trainer(settings, config, create_run(config))


def flown(run_dir: Path, *overrides: str, lift: float | None = None) -> Run:
    """Trains; with ``lift`` the policy's vertical velocity is that, in m/s, whatever it sees."""
    trainer = built(run_dir, *overrides)
    if lift is not None:
        with torch.no_grad():
            trainer.checkpoint.components["policy"].module.net[-1].bias[2] = math.atanh(lift / 2)
    updates: list[int] = []  # known when the next episode is recorded
    record = trainer.record
    trainer.record = lambda batch: (updates.append(trainer.stepper.updates), record(batch))  # type: ignore[method-assign]
    trainer.save()
    trainer.train()
    return Run(trainer, read_episodes(run_dir / "episodes.csv"), [*updates[1:], trainer.stepper.updates])


def policy_of(run: Run, observation: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return run.trainer.checkpoint.components["policy"].module(observation)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """64 random steps (the first two batches of 32), then noise of 0.1 · 2 m/s."""
    return flown(tmp_path_factory.mktemp("noisy") / "run", *FROZEN, "trainer.episodes=30", "algo.learning_starts=64")


@pytest.fixture(scope="module")
def learning(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return flown(tmp_path_factory.mktemp("learning") / "run", "trainer.episodes=16")


# ---------------------------------------------------------------------- updates


def test_after_an_episode_of_t_steps_come_t_updates(learning: Run) -> None:
    run = learning
    assert len(run.updates) == len(run.episodes) == 16
    expected, total = [], 0
    for episode in run.episodes:
        total += episode.steps if episode.total_steps >= 40 else 0
        expected.append(total)
    assert expected[0] == 0
    assert expected[-1] > 50
    assert run.updates == expected


@pytest.mark.parametrize(("per_step", "learning_starts"), [(0.3125, 0), (1.5, 0), (1.5, 500)])
def test_fractions_of_an_update_add_up_after_the_random_steps(
    per_step: float, learning_starts: int, tmp_path: Path
) -> None:
    asked = [f"algo.learning_starts={learning_starts}", f"trainer.updates_per_step={per_step}"]
    run = flown(tmp_path / "run", "trainer.episodes=4", *asked)
    assert run.updates == [0 if learning_starts else math.floor(per_step * e.total_steps) for e in run.episodes]


@pytest.mark.parametrize(("demonstrator", "first"), [("none", "random"), ("vfh", "scripted")])
def test_a_silence_is_explained_by_what_the_run_does_then(
    demonstrator: str, first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Callable[[], str]] = []
    notice = lambda text: asked.append(text) or StallNotice(text)  # type: ignore[func-returns-value]  # noqa: E731
    monkeypatch.setattr("uavrl.training.trainer.StallNotice", notice)
    trainer = built(tmp_path / "run", f"demonstrator={demonstrator}", "algo.learning_starts=1500")
    told = {}
    for trainer.collected_frames in (0, 1499, 1500):
        told[trainer.collected_frames] = asked[0]()
    controller = " The scripted controller acts until step 1,500, and its episodes are learned from, too."
    assert told[1500].endswith("for each of its steps; the first are compiled.")
    assert (
        told[0]
        == told[1499]
        == {
            "random": "No episode has ended for a while: one takes up to env.max_steps steps, random ones until step "
            "1,500, before which no updates are made.",
            "scripted": told[1500] + controller,
        }[first]
    )


# ---------------------------------------------------------------------- what is stored


def test_the_buffer_holds_exactly_the_logged_steps(noisy: Run) -> None:
    assert len(noisy.stored) == noisy.trainer.collected_frames == noisy.episodes[-1].total_steps
    for steps, episode in zip(noisy.stored_episodes(), noisy.episodes, strict=True):
        assert steps["next", "done"][:, 0].tolist() == [False] * (episode.steps - 1) + [True]
        assert steps["next", "reward"].double().sum().item() == pytest.approx(episode.episode_return)


def test_a_time_out_is_done_and_not_terminated(tmp_path: Path) -> None:
    run = flown(tmp_path / "run", *FROZEN, "trainer.episodes=4", "algo.learning_starts=0", lift=0.0)
    timed_out = [s[-1] for s, e in zip(run.stored_episodes(), run.episodes, strict=True) if e.outcome == "timed_out"]
    ends = [[last["next", key].item() for key in ("done", "terminated", "arrived")] for last in timed_out]
    assert ends == [[True, False, False]] * len(timed_out) and timed_out


def test_a_collision_is_done_and_terminated(tmp_path: Path) -> None:
    run = flown(
        tmp_path / "run", *FROZEN, "trainer.episodes=2", "algo.learning_starts=0", "env.max_steps=60", lift=-1.99
    )
    assert [e.outcome for e in run.episodes] == ["collided", "collided"]
    for steps in run.stored_episodes():
        assert steps["next", "terminated"][:, 0].tolist() == [False] * (len(steps) - 1) + [True]
        assert steps["next", "done"][-1].item()
        assert steps["next", "reward"][-1].item() < -40


def test_the_next_observation_is_the_following_one(noisy: Run) -> None:
    for steps in noisy.stored_episodes():
        assert torch.equal(steps["next", "observation"][:-1], steps["observation"][1:])


def test_frames_move_up_by_one_and_begin_empty(noisy: Run) -> None:
    for steps in noisy.stored_episodes():
        before, after = steps["observation"].unflatten(-1, (3, 35)), steps["next", "observation"].unflatten(-1, (3, 35))
        assert torch.equal(after[:, :2], before[:, 1:])
        assert (before[0, :2] == 0).all()
        assert (before[0, 2] != 0).any()


# ---------------------------------------------------------------------- exploration


def test_actions_are_random_at_first_and_noisy_ones_of_the_policy_later(noisy: Run) -> None:
    stored = noisy.stored
    residual = stored["action"] - policy_of(noisy, stored["observation"])
    # Noise does not reach 1 m/s (five σ), a uniform action stays below it in all four components at odds of 1 to 16.
    random = (residual.abs() > 1.0).any(-1)
    assert 48 <= random.sum() <= 64
    assert not random[-150:].any()
    assert stored["action"][random].std().item() == pytest.approx(4 / math.sqrt(12), rel=0.1)
    assert stored["action"][random].abs().max() <= 2.0
    noise = residual[-150:]
    torch.testing.assert_close(noise.std(0), torch.full((4,), 0.2), rtol=0.25, atol=0)
    torch.testing.assert_close(noise.mean(0), torch.zeros(4), rtol=0, atol=0.07)
    assert len(noise.unique(dim=0)) == 150, "vehicles share their noise"
    assert torch.corrcoef(noise.T).fill_diagonal_(0).abs().max() < 0.35


def test_without_noise_the_actions_are_the_policys_and_noisy_ones_stay_within_the_limits(tmp_path: Path) -> None:
    calm, noisy = ([f"algo.exploration_noise={noise}", "algo.learning_starts=0"] for noise in (0, 0.1))
    run = flown(tmp_path / "calm", *FROZEN, *calm, "trainer.episodes=2")
    torch.testing.assert_close(run.stored["action"], policy_of(run, run.stored["observation"]), atol=1e-5, rtol=0)
    run = flown(tmp_path / "noisy", *FROZEN, *noisy, "trainer.episodes=4", lift=1.99)
    assert run.stored["action"].abs().max() == 2.0


# ---------------------------------------------------------------------- barriers


def test_a_barrier_restarts_the_environment_at_task_0_with_a_seed_of_its_own(tmp_path: Path, learning: Run) -> None:
    config, run = small_config(tmp_path), learning
    world = World(validate(config).env.world)
    segments: list[list[Episode]] = [[]]
    for episode in run.episodes:
        flown = {e.task for e in segments[-1]}
        if episode.task in flown:
            assert flown == set(range(len(flown))), "a flight that was open at a checkpoint is missing"
            segments.append([])
        segments[-1].append(episode)
    assert len(segments) >= 3
    seeds = [barrier_seed(0, segment[0].episode - 1) for segment in segments]
    assert len(set(seeds)) == len(seeds)
    for seed, segment in zip(seeds, segments, strict=True):
        assert sorted(e.task for e in segment) == list(range(len(segment)))
        for episode in segment:
            task = world.sample_task(np.random.default_rng((seed, episode.task)), avoid=np.zeros((0, 3)))
            assert (episode.start_x, episode.start_y, episode.start_z) == pytest.approx(tuple(task.start), abs=1e-4)
            assert (episode.goal_x, episode.goal_y, episode.goal_z) == pytest.approx(tuple(task.goal), abs=1e-4)
    assert max(e.steps for e in run.episodes) <= 12
    for steps in run.stored_episodes()[-5:]:
        assert (steps["observation"][0, :70] == 0).all()


# ---------------------------------------------------------------------- a loss that is no number


def test_a_loss_that_is_no_number_ends_the_run_and_leaves_the_checkpoints(tmp_path: Path) -> None:
    trainer = built(tmp_path / "run", "trainer.episodes=10", "trainer.checkpoint_interval=100000")
    trainer.save()
    before = {p: p.read_bytes() for p in (tmp_path / "run/checkpoints").iterdir()}
    assert before
    with torch.no_grad():
        for value in trainer.loss.critic_network_params.values(True, True):
            value.fill_(math.nan)
    try:
        with pytest.raises(UavrlError, match=r"critic's loss became nan after \d+ updates"):
            trainer.train()
    finally:
        trainer.collector.shutdown()
    assert {p: p.read_bytes() for p in (tmp_path / "run/checkpoints").iterdir()} == before


def test_training_gives_denormal_arithmetic_back(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "trainer.episodes=3")
    during: list[bool] = []

    def halves_to_zero() -> bool:
        return bool(torch.tensor(torch.finfo(torch.float32).tiny) / 2 == 0)

    original = EpisodeTrainer.train
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EpisodeTrainer, "train", lambda self: (during.append(halves_to_zero()), original(self)))
        train(config, create_run(config))
    assert during == [True]
    assert not halves_to_zero()


def test_the_trainer_logs_the_mean_of_each_term(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "trainer.episodes=3", "reward=traditional", "logger.interval=1")
    train(config, create_run(config))
    episodes = read_episodes(tmp_path / "run/episodes.csv")
    (logged,) = (tmp_path / "run/logs").rglob("return_progress.csv")
    step, value = logged.read_text().splitlines()[-1].split(",")
    assert int(step) == episodes[-1].total_steps
    assert float(value) == pytest.approx(sum(episode.terms["progress"] for episode in episodes) / 3, abs=1e-4)


def test_a_lifeguard_that_is_not_heard_changes_nothing_but_what_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit, fitted = LifeGuard.fit, []

    def with_numbers_of_its_own(self: LifeGuard, *args: Any, **kwargs: Any) -> None:
        with torch.random.fork_rng(devices=[]):
            fit(self, *args, **kwargs)
        fitted.append(self.active)

    monkeypatch.setattr(LifeGuard, "fit", with_numbers_of_its_own)
    where = ["trainer.episodes=16", "reward.collided_reward=-50", *(o for o in LIFEGUARD if o.startswith("env."))]

    def trained(name: str, *overrides: str) -> tuple[bytes, dict[str, Tensor]]:
        run = tmp_path / name
        config = small_config(run, *where, *overrides)
        train(config, create_run(config))
        return (run / "episodes.csv").read_bytes(), dict(load_actor(run, None, "cpu")[1].state_dict())

    flights, actor = trained("none")
    unheard = trained("unheard", "lifeguard=linear", *LIFEGUARD, "lifeguard.min_evaluations=1000")
    assert fitted and not any(fitted)
    assert unheard[0] == flights
    torch.testing.assert_close(unheard[1], actor, rtol=0, atol=0)
    heard = trained("heard", "lifeguard=linear", *LIFEGUARD)
    assert any(fitted)
    assert not all(torch.equal(heard[1][key], value) for key, value in actor.items())
