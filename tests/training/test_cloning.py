"""The actor clones a demonstrator in the states that it reaches itself."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded

from tests.helpers.runs import small_config
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.losses import Imitation, TD3Loss
from uavrl.models import Actor, Critic
from uavrl.runs.episodes import read_episodes
from uavrl.training.build import build_trainer
from uavrl.training.cloning import Cloning
from uavrl.training.run import create_run, seed_everything, train
from uavrl.training.trainer import EpisodeTrainer

SEEN = ["perception=range_image", "perception.last_action=true", "buffer.mirror=true", "demonstrator=vfh"]
CLONED = [
    *("cloning=dagger", "cloning.steps=100", "cloning.updates_per_step=0.5", "cloning.batch_size=32"),
    *("cloning.critic_updates=20", *SEEN),
]


def make_loss() -> TD3Loss:
    torch.manual_seed(0)
    actor = TensorDictModule(Actor(6, 2, (32,)), ["observation"], ["action"])
    critics = [TensorDictModule(Critic(6, 2, (16,)), ["observation", "action"], ["state_action_value"]) for _ in "12"]
    return TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (2,)))


def shown(states: torch.Tensor) -> TensorDict:
    """States with the action of a demonstrator that goes one way or the other."""
    action = 1.5 * torch.stack([states[:, 0].sign(), (states[:, 1] - states[:, 2]).tanh()], -1)
    return TensorDict({"observation": states, "demonstrator_action": action}, [len(states)])


def distance(loss: TD3Loss) -> float:
    held_out = shown(torch.randn(500, 6, generator=torch.Generator().manual_seed(1)))
    with torch.no_grad():
        return (loss.act(held_out)["action"] - held_out["demonstrator_action"]).abs().mean().item()


@pytest.mark.parametrize("execution", ["eager", "captured"])
def test_it_learns_what_the_demonstrator_does_in_states_not_seen(execution: str) -> None:
    loss = make_loss()
    before, critics = distance(loss), copy.deepcopy(loss.qvalue_network_params)
    cloning = Cloning(loss, 2.0, steps=400, updates_per_step=1.0, lr=1e-2, final_lr=1e-3, execution=execution)
    first = cloning.learn([shown(torch.randn(64, 6))], steps=1)
    for step in range(2, 401):
        last = cloning.learn([shown(torch.randn(64, 6))], steps=step)
    assert first is not None and last is not None and last < 0.2 * first
    assert before > 1.0 and distance(loss) < 0.3
    assert (loss.qvalue_network_params == critics).all(), "critics take no part"
    actor, target = loss.actor_network_params, loss.target_actor_network_params
    assert cloning.finished and (actor.data == target.data).all()


def test_its_distance_and_its_learning_rate_are_these_numbers() -> None:
    """Actions 1 and 3 off, of at most 2: (0.5² + 1.5²) / 2."""
    loss = make_loss()
    loss.actor_network_params.data.zero_()
    cloning = Cloning(loss, 2.0, steps=100, lr=1e-2, final_lr=1e-4)
    batch = TensorDict({"observation": torch.ones(5, 6), "demonstrator_action": torch.tensor([[1.0, 3.0]] * 5)}, [5])
    assert cloning.learn([batch], steps=50) == pytest.approx(1.25)
    assert cloning.step.optimizer.param_groups[0]["lr"] == pytest.approx(1e-3)
    cloning.learn([], steps=200)
    assert cloning.step.optimizer.param_groups[0]["lr"] == pytest.approx(1e-4)


def test_updates_are_spread_over_the_steps_and_end_with_them() -> None:
    loss = make_loss()
    cloning = Cloning(loss, 2.0, steps=10, updates_per_step=0.4)
    due = []
    for steps in (1, 2, 3, 8, 9, 12, 20):
        due.append(cloning.due(steps))
        cloning.learn([shown(torch.randn(4, 6))] * due[-1], steps)
        assert cloning.finished == (steps >= 12)
    assert due == [0, 0, 1, 2, 0, 1, 0]


def test_the_weight_of_imitation_decays_from_the_end_of_the_phase_on() -> None:
    loss = Imitation(make_loss(), limit=2.0, weight=4.0, final_weight=1.0, decay_steps=10)
    cloning = Cloning(loss, 2.0, steps=10, updates_per_step=0.4)
    found = []
    for steps in (5, 10, 15, 20):
        loss.observe(shown(torch.randn(5, 6)))  # as a run shows each new episode
        if not cloning.finished:
            cloning.learn([shown(torch.randn(4, 6))] * cloning.due(steps), steps)
        found.append(loss.weight.item())
    assert found == pytest.approx([2.0, 4.0, 2.0, 1.0])


def test_a_run_clones_first_and_then_learns_from_rewards(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", *CLONED, "trainer.episodes=20", "logger.interval=1")
    settings = validate(config)
    seed_everything(settings.seed)
    trainer = build_trainer(settings, config, create_run(config))
    assert trainer.cloning is not None
    seen, record = [], trainer.record
    trainer.record = lambda batch: (  # type: ignore[method-assign]
        seen.append((trainer.cloning.updates, trainer.stepper.updates)),  # type: ignore[union-attr]
        record(batch),
    )
    trainer.save()
    trainer.train()
    episodes = read_episodes(tmp_path / "run/episodes.csv")
    for episode, after in zip(episodes, [*seen[1:], (trainer.cloning.updates, trainer.stepper.updates)], strict=True):
        assert after[0] == min(episode.total_steps, 100) // 2
        assert (after[1] > 0) == (episode.total_steps - episode.steps >= 100)
    assert trainer.updates == 50 + trainer.stepper.updates > 50
    (log,) = (tmp_path / "run/logs").rglob("loss_cloning.csv")
    losses = [float(line.split(",")[-1]) for line in log.read_text().splitlines()]
    assert losses[-1] < losses[0]


def test_a_run_that_goes_on_after_its_cloning_phase_warms_its_critics_up_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended with the phase, and then was given more steps."""
    found: list[int] = []
    monkeypatch.setattr(EpisodeTrainer, "warm_up", lambda _, updates: found.append(updates))
    config = small_config(tmp_path / "run", *CLONED, "trainer.steps=100")
    run_dir = create_run(config)
    train(config, run_dir)
    assert not found
    config.trainer.steps = 140
    train(config, run_dir, resume=True)
    assert found == [20]


@pytest.mark.parametrize(("steps", "warmed"), [(100, []), (140, [(20, 0)])])
def test_critics_learn_before_the_actor_learns_from_them(
    steps: int, warmed: list[tuple[int, int]], tmp_path: Path
) -> None:
    """Only where the run goes on after the phase, and the actor stays as it was cloned."""
    config = small_config(tmp_path / "run", *CLONED, f"trainer.steps={steps}")
    trainer = build_trainer(validate(config), config, create_run(config))
    warm_up, found = trainer.warm_up, []
    actor, critics = trainer.loss.actor_network_params, trainer.loss.qvalue_network_params

    def noted(updates: int) -> None:
        found.append((updates, trainer.stepper.updates))
        before = actor.data.clone(), critics.data.clone()
        warm_up(updates)
        assert (actor.data == before[0]).all() and not (critics.data == before[1]).all()

    trainer.warm_up = noted  # type: ignore[method-assign]
    trainer.save()
    trainer.train()
    assert found == warmed


def test_it_needs_a_demonstrator(tmp_path: Path) -> None:
    config = small_config(tmp_path / "run", "cloning=dagger")
    with pytest.raises(UavrlError, match=r"demonstrator must be a scripted controller, such as vfh, which cloning=dag"):
        build_trainer(validate(config), config, create_run(config))


def test_a_phase_without_a_single_update_is_refused() -> None:
    with pytest.raises(
        UavrlError, match=r"cloning\.updates_per_step=0\.01 makes no update in 60 steps, so nothing would"
    ):
        Cloning(make_loss(), 2.0, steps=60, updates_per_step=0.01)
    assert Cloning(make_loss(), 2.0, steps=100, updates_per_step=0.01).due(100) == 1
