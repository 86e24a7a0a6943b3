"""Trainings with a demonstrator."""

from __future__ import annotations

from pathlib import Path

from tests.helpers.commands import DEFAULT_VALLEY
from tests.helpers.runs import small_config
from uavrl.config.validation import validate
from uavrl.evaluation.actor import read_policy
from uavrl.losses.imitation import action_distance
from uavrl.runs.episodes import read_episodes
from uavrl.training.build import make_training_env
from uavrl.training.run import create_run, train

EASY = [
    *DEFAULT_VALLEY,
    "env.world.goal_radius=14",
    "env.world.obstacles=0",
    "env.max_steps=60",
    "env.world.min_clearance=3",
]


def test_flights_of_the_guide_are_learned_from_at_once(tmp_path: Path) -> None:
    rule = ["trainer.episodes=30", "logger.interval=1"]
    config = small_config(tmp_path / "run", "demonstrator=vfh", "algo.learning_starts=300", *EASY, *rule)
    train(config, create_run(config))
    flights = read_episodes(tmp_path / "run" / "episodes.csv")
    assert sum(flight.total_steps <= 300 for flight in flights) >= 3
    (file,) = (tmp_path / "run" / "logs").rglob("optim_steps.csv")
    first = file.read_text().splitlines()[0]
    assert int(first.split(",")[0]) < 300, "updates begin with the first flight"


def test_a_policy_that_imitates_comes_to_fly_as_its_guide(tmp_path: Path) -> None:
    seen = ["perception=range_image", "perception.last_action=true", "buffer.mirror=true", "algo.n_steps=3"]
    learn = ["algo.learning_starts=64", "trainer.episodes=40", "trainer.updates_per_step=2", "algo.actor_lr=1e-3"]
    far = {}
    for weight in (0.0, 100.0):
        flown = [
            "demonstrator=vfh",
            "actor_penalty=imitation",
            f"actor_penalty.weight={weight}",
            "algo.exploration_noise=0.1",
        ]
        config = small_config(tmp_path / f"run{weight}", *flown, *seen, *learn, *EASY)
        train(config, create_run(config))
        policy = read_policy(tmp_path / f"run{weight}")
        env = make_training_env(validate(config), seed=0)
        states = env.rollout(20, policy=policy, break_when_any_done=False)
        far[weight] = action_distance(states["action"], states["demonstrator_action"], 2.0).mean().item()
        env.close()
    assert far[100.0] < 0.5 * far[0.0]
