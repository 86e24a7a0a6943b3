"""The walker of ``examples``: somebody else's environment, reward, buffer and FORK variant, chosen by yaml alone."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from torchrl.envs import TransformedEnv, check_env_specs
from walker.buffer import FailureBias
from walker.env import BipedalEnv
from walker.fork import BipedalFork
from walker.reward import WalkerReward

from tests.helpers.commands import in_process
from tests.helpers.contracts import ActorCriticLossContract
from tests.helpers.finished import finished_run
from tests.helpers.losses import Scale, small_td3, states, td3
from tests.helpers.runs import assert_same_run
from uavrl.cli import evaluate, replay
from uavrl.cli import train as train_command
from uavrl.config import compose, learner_name, validate
from uavrl.errors import UavrlError
from uavrl.models import SystemNet
from uavrl.reporting.report import make_report
from uavrl.runs.checkpoint import rotation
from uavrl.runs.episodes import read_episodes
from uavrl.training.run import create_run, train
from uavrl.training.update import ActorCriticStepper

EXAMPLE = Path(__file__).resolve().parents[1]
CONFIG_DIR, TRUSTED = ["--config-dir", str(EXAMPLE / "conf")], "packages=[walker]"
SMALL = [
    "env=bipedal_hardcore",
    "env.max_steps=90",  # some fall before, some do not
    "algo.batch_size=8",
    "buffer.capacity=400",
    "trainer.progress=false",
    "trainer.matmul=mkl",  # `auto` could turn with the machine's load
    "trainer.execution=captured",
]
LEARNERS = sorted(path.stem for path in (EXAMPLE / "conf/learner").glob("*.yaml"))


def walker_config(*overrides: str) -> DictConfig:
    return compose(TRUSTED, *overrides, own=[EXAMPLE / "conf"])


# ---------------------------------------------------------------------- environment and reward


def walk(env: BipedalEnv, steps: int = 150) -> torch.Tensor:
    """Observations of two episodes under the same torques."""
    torch.manual_seed(0)
    return torch.cat([env.rollout(steps)["next", "observation"] for _ in range(2)])


def test_it_matches_its_specs() -> None:
    env = TransformedEnv(BipedalEnv(), WalkerReward())
    check_env_specs(env)
    assert env.observation_spec["observation"].shape == (24,)
    assert env.action_spec.shape == (4,)


def test_a_course_depends_on_seed_and_number_alone() -> None:
    env = BipedalEnv(seed=3)
    first = walk(env)
    env.set_seed(3)  # in a process that has walked
    assert torch.equal(walk(env), first)
    assert torch.equal(walk(BipedalEnv(seed=3)), first)
    assert not torch.equal(walk(BipedalEnv(seed=4))[:40], first[:40])


def test_a_fall_ends_an_episode_and_costs_less() -> None:
    """It sinks into its knees: a fall is -5, whatever it was; the rest counts five times."""
    env = TransformedEnv(BipedalEnv(seed=0), WalkerReward())
    state, paid = env.reset(), 0.0
    assert not state["collided"] and not state["arrived"] and state["task"].item() == 0
    while not state["done"]:
        before = state["episode_reward"]
        state = env.step(state.set("action", torch.zeros(4)))["next"]
        paid += state["reward"].item()
    assert state["collided"] and state["terminated"] and not state["arrived"] and not state["truncated"]
    assert state["reward"].item() == -5.0 and (state["episode_reward"] - before).item() == pytest.approx(-100.0)
    assert paid == pytest.approx(5 * before.item() - 5, rel=1e-4)
    assert env.reset()["task"].item() == 1


def test_the_end_of_the_course_is_an_arrival() -> None:
    env = BipedalEnv()
    state = env.reset()
    hull = env._env.unwrapped.hull
    for body in (hull, *env._env.unwrapped.legs):
        body.position = (body.position[0] + 87.0, body.position[1] + 3.0)
    state = env.step(state.set("action", torch.zeros(4)))["next"]
    assert state["arrived"] and state["terminated"] and not state["collided"]


def test_the_limit_of_steps_truncates() -> None:
    last = BipedalEnv(max_steps=5).rollout(9)[-1]["next"]
    assert last["truncated"] and last["done"]
    assert not last["terminated"] and not last["arrived"] and not last["collided"]


def test_without_box2d_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "Box2D", None)
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.box2d")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(UavrlError, match=r"needs Box2D.*gymnasium\[box2d\]"):
        BipedalEnv()


# ---------------------------------------------------------------------- the filter


def episode(fell: bool, value: float) -> TensorDict:
    after = {"collided": torch.tensor([[False], [fell]]), "episode_reward": torch.tensor([[0.0], [value]])}
    return TensorDict({"next": after}, [2])


def test_the_counter_grows_by_1_a_fall_and_sinks_by_10_a_stored_success() -> None:
    bias = FailureBias(probability=1.0)
    seen = []
    for fell, value in [(True, 280.0), (False, 249.9), (False, 250.0), (False, 300.0), (True, 0.0)]:
        seen.append((bias.keeps(episode(fell, value)), bias.falls))
    assert seen == [(True, 1), (True, 1), (True, -9), (False, -9), (True, -8)]
    assert bias.diagnostics() == {"buffer_falls": -8.0, "buffer_left_out": 1.0}


def test_half_of_the_successes_are_stored_and_the_coin_goes_on_where_it_was() -> None:
    one, other = FailureBias(falls_per_success=0, seed=1), FailureBias(falls_per_success=0, seed=2)
    one.keeps(episode(True, 0.0))
    other.load_state_dict(one.state_dict())
    flips = [[bias.keeps(episode(False, 300.0)) for _ in range(1000)] for bias in (one, other)]
    assert flips[0] == flips[1] and 440 < sum(flips[0]) < 560  # four standard deviations


# ---------------------------------------------------------------------- FORK's variant


class TestBipedalFork(ActorCriticLossContract):
    methods: ClassVar[dict[str, str]] = {
        "value_loss": "critic",
        "actor_loss": "actor",
        "system_loss": "model",
        "model_loss": "model",
    }

    def make_loss(self, **kwargs: object) -> BipedalFork:
        system = SystemNet(6, 2, (8,))
        loss = BipedalFork(td3(**kwargs), system_network=system, observations=6, max_reward=300.0, base_weight=1.0)
        loss.update_gate(0.0)
        return loss


def small() -> BipedalFork:
    """On ``small_td3``: f(s, a) = s + a."""
    options = {"observations": 1, "base_weight": 0.5, "max_reward": 10.0}
    return BipedalFork(small_td3(), system_network=Scale(1.0, 1.0), **options)


def test_actor_loss_by_hand() -> None:
    """Target values 5 a throughout: with the gate closed -5 · 2, then also -0.5 · 5 · 6 - 0.25 · 5 · 18."""
    loss = small()
    assert loss.actor_loss(states(1.0))[0].item() == pytest.approx(-10.0)
    loss.update_gate(0.0)
    assert loss.actor_loss(states(1.0))[0].item() == pytest.approx(-47.5)
    assert loss.base.actor_loss(states(1.0))[0].item() == pytest.approx(-7.0), "Q1 = s + 3 a where it stands alone"


def test_the_system_loss_leaves_out_last_steps() -> None:
    data = states(2.0, 2.0).set("action", torch.ones(2, 1))
    data["next"] = TensorDict({"observation": torch.zeros(2, 1), "done": torch.tensor([[False], [True]])}, [2])
    assert small().system_loss(data)[0].item() == pytest.approx(4.5)  # (3² + 0) / 2


# ---------------------------------------------------------------------- its yaml


def test_the_learners_have_the_numbers_of_the_published_codes() -> None:
    found = {name: validate(walker_config("env=bipedal_hardcore", f"learner={name}")) for name in LEARNERS}
    assert list(found) == ["td3_fork_walker", "td3_lg_walker", "td3_walker"]
    for name, settings in found.items():
        choices = settings.choices
        chosen = [choices[group] for group in ("perception", "reward", "buffer")]
        assert chosen == ["none", "walker", "failure_biased"]
        assert learner_name(choices) == name.removesuffix("" if "fork" in name else "_walker")
        widths, lr, tau = ([256, 256], 3e-4, 0.02) if "fork" in name else ([400, 300], 1e-3, 0.005)
        algo = settings.algo
        assert (algo.actor.hidden, algo.critic.hidden) == (widths, widths)
        assert (algo.actor_lr, algo.critic_lr, algo.tau) == (lr, lr, tau)


def test_figure_4_6_flies_the_three_learners() -> None:
    config = walker_config("experiment=figure_4_6")
    assert config.run_dir.startswith("runs/figure_4_6/")
    text = (EXAMPLE / "conf/experiment/figure_4_6.yaml").read_text()
    assert set(text.split("learner: ")[1].strip().split(",")) == set(LEARNERS)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["learner=td3_walker", "fork=on"],
            "learner=td3_walker selects fork=none, but the command line selects fork=on",
        ),
        (["buffer=failure_biased", "buffer.probability=1.5"], "buffer.probability must be in [0, 1], got 1.5"),
        (["buffer=failure_biased", "+buffer.seed=3"], "buffer.seed"),
        (["fork=walker", "fork.threshold=0"], "fork.threshold must be above 0"),
        (["buffer.mirror=true"], "buffer.mirror must be false"),
        (["reward=traditional"], "The reward reads 'distance', which BipedalEnv does not emit"),
    ],
)
def test_its_mistakes_are_one_sentence(overrides: list[str], said: str, refused: Callable[..., str]) -> None:
    assert said in refused(train_command.main, *CONFIG_DIR, TRUSTED, "env=bipedal_hardcore", *overrides)


# ---------------------------------------------------------------------- runs


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    few = ["trainer.episodes=8", "algo.learning_starts=1000", "algo.hidden=[8]"]  # no network decides how a walk ends
    return finished_run(tmp_path_factory.mktemp("runs") / "run", *CONFIG_DIR, TRUSTED, *SMALL, *few)


def test_evaluation_walks_the_same_courses_again(finished: Path) -> None:
    results = []
    for _ in range(2):
        assert in_process(evaluate.main, f"run={finished}", TRUSTED, "episodes=2", "progress=false") == 0
        results.append(json.loads((finished / "evaluation_episodes=2.json").read_text()))
    assert results[0] == results[1]
    assert [walk["task"] for walk in results[0]["flights"]] == [0, 1]
    assert results[0]["env"] == "bipedal_hardcore" and "valleys" not in results[0]


def test_returns_are_recorded_as_gymnasium_gives_them(finished: Path) -> None:
    """A walker of 90 steps cannot earn or lose 60 but by a fall, which is -5 among the scaled rewards."""
    episodes = read_episodes(finished / "episodes.csv")
    assert {episode.outcome for episode in episodes} == {"collided", "timed_out"}
    for walked in episodes:
        assert (walked.outcome == "collided") == (walked.episode_return < -60)
    report = make_report([finished])
    assert report.title == "Training runs, env=bipedal_hardcore"
    assert [group["label"] for group in report.groups] == ["TD3, walker"]


@pytest.mark.parametrize(
    ("main", "overrides", "told"),
    [
        (replay.main, [], "shows flights in the valley"),
        (evaluate.main, ["valleys=[1]"], "valleys is for the valley, and the environment is bipedal_hardcore"),
        (evaluate.main, ["env=static"], "The policy reads 'observation', which NavigationEnv does not emit"),
    ],
)
def test_what_only_the_valley_has_is_refused(
    finished: Path, main: Callable[[], None], overrides: list[str], told: str, refused: Callable[..., str]
) -> None:
    assert told in refused(main, f"run={finished}", TRUSTED, *overrides)


ENHANCED = [
    "fork=walker",
    "lifeguard=linear",
    "buffer=failure_biased",
    "buffer.success_return=-20",  # which walkers that do not fall reach
    "algo.learning_starts=100",
    "algo.hidden=[16,16]",
    "algo.actor_lr=1e-3",
    "lifeguard.min_collisions=1",
    "lifeguard.min_evaluations=0",
    "lifeguard.min_true_negative_rate=0",
    "lifeguard.batch_size=8",
    "fork.threshold=10",
    "fork.system_network.hidden=[16]",
    "trainer.checkpoint_interval=90",
    "trainer.keep_checkpoints=10",
    "logger.interval=1",
]


def test_a_resumed_run_with_both_penalties_is_bit_identical(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole/run", tmp_path / "cut/run"  # the logger names its folder by the last part
    told = [*SMALL, *ENHANCED, "trainer.episodes=12"]
    for run_dir in (whole, cut):
        config = walker_config(*told, f"run_dir={run_dir}")
        train(config, create_run(config))
    later = rotation(cut).checkpoints()[2:]
    assert len(later) >= 2
    for checkpoint in later:
        checkpoint.unlink()
    assert in_process(train_command.main, f"resume={cut}", TRUSTED) == 0
    assert_same_run(whole, cut)
    logged = {log.stem: log.read_text().splitlines() for log in (whole / "logs").rglob("*.csv")}
    assert float(logged["buffer_left_out"][-1].split(",")[-1]) > 0
    for said in ("lifeguard_penalty", "fork_gate"):
        assert max(float(line.split(",")[-1]) for line in logged[said]) > 0, said


def test_the_actor_waits_after_a_walk_that_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The walks from the fifth on are left out: three updates come after each, of the critics alone."""
    few = ["trainer.episodes=8", "buffer=failure_biased", "buffer.updates_when_left_out=3", "algo.learning_starts=100"]
    config = walker_config(*SMALL, *few, "algo.hidden=[16,16]", f"run_dir={tmp_path / 'run'}")
    walks, actor_learns = itertools.count(1), []
    step = ActorCriticStepper.step
    monkeypatch.setattr(FailureBias, "keeps", lambda *_: next(walks) < 5)
    monkeypatch.setattr(
        ActorCriticStepper, "step", lambda self, *batch: actor_learns.append(self.actor_learns) or step(self, *batch)
    )
    train(config, create_run(config))
    assert actor_learns[0] and actor_learns[-13:] == [True] + [False] * 12
