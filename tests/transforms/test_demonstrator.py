"""First steps that a demonstrator flies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, InitTracker, TransformedEnv, check_env_specs, step_mdp

from tests.helpers.configs import composed
from tests.helpers.own_parts import CHOSEN, OWN, TRUSTED
from tests.helpers.runs import small_config
from tests.helpers.valleys import NEAR, SMALL
from uavrl.config import compose
from uavrl.config.validation import validate
from uavrl.envs import NavigationEnv
from uavrl.errors import UavrlError
from uavrl.losses import ActionRate, ActorPenalty
from uavrl.losses.networks import NetworkSizes, make_actor, network_sizes
from uavrl.policies.baselines import VectorFieldHistogram
from uavrl.runs.episodes import read_episodes
from uavrl.training.build import make_buffer, make_loss, make_training_env
from uavrl.training.progress import warn_of_late_learning
from uavrl.training.run import create_run, train
from uavrl.transforms import Mirror
from uavrl.transforms.composition import inner_transforms
from uavrl.transforms.demonstrator import Demonstrator, DemonstratorEnv


class Calm(ActorPenalty):
    """An actor penalty from elsewhere that says nothing of n-step returns."""

    def actor_term(self, acted: TensorDictBase) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        return acted["action"].square().sum(-1), {}


class Still:
    """A demonstrator from elsewhere, which reads nothing and hovers."""

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", torch.zeros(*tensordict.batch_size, 4))


def test_the_guides_actions_are_flown_with_noise_and_chance_flies_without_one(tmp_path: Path) -> None:
    for noise in (0.0, 0.1):
        config = small_config(tmp_path / "run", "demonstrator=vfh", f"algo.exploration_noise={noise}")
        env = make_training_env(validate(config), seed=0)
        state = env.reset()
        expected = VectorFieldHistogram()(state.clone())["action"]
        assert torch.equal(state["demonstrator_action"], expected)
        check_env_specs(env)
        got = env.rand_action(state)["action"]
        assert torch.equal(got, expected) == (noise == 0.0)
        torch.testing.assert_close(got, expected, atol=1.0, rtol=0.0)
        env.close()
    plain = make_training_env(validate(small_config(tmp_path / "run")), seed=0)
    assert not isinstance(plain, DemonstratorEnv)
    plain.close()


def test_a_guide_of_ones_own_flies_the_first_steps_and_no_later_ones(tmp_path: Path) -> None:
    first = ["packages=[tests]", "algo.exploration_noise=0", "algo.learning_starts=40", "trainer.episodes=8"]
    config = small_config(tmp_path / "run", *first)
    config.demonstrator = {"_target_": "tests.transforms.test_demonstrator.Still"}
    train(config, create_run(config))
    flights = read_episodes(tmp_path / "run" / "episodes.csv")
    assert [flight.outcome for flight in flights[:2]] == ["timed_out"] * 2, "it hovers"


def test_a_guide_that_reads_what_no_environment_emits_is_told(tmp_path: Path) -> None:
    told = [
        "demonstrator.flight_level=3",
        "demonstrator.radius=4",
        "demonstrator.reduction=range_image",
        "demonstrator.statistic=proximity",
    ]
    told += ["demonstrator.last_action=false", "demonstrator.motion=null", "demonstrator.grid=null"]
    config = compose(*CHOSEN, TRUSTED, "demonstrator=vfh", *told, f"run_dir={tmp_path}", own=[OWN / "conf"])
    with pytest.raises(UavrlError, match="demonstrator reads 'faces'"):
        make_training_env(validate(config), seed=0)


def test_a_guide_that_may_never_hand_over_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for limit, told in (("episodes=20", True), ("episodes=200", False), ("steps=300", True), ("steps=301", False)):
        caplog.clear()
        length = [f"trainer.{limit}"] if limit.startswith("episodes") else ["trainer.episodes=200", f"trainer.{limit}"]
        few = ["demonstrator=vfh", "algo.learning_starts=300", "env.max_steps=30", *length]
        warn_of_late_learning(validate(small_config(tmp_path / "run", *few)))
        assert (f"the scripted controller may act for the whole run, trainer.{limit}," in caplog.text) == told


def test_random_steps_that_last_as_long_as_the_run_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for steps, told in ((300, True), (301, False)):
        caplog.clear()
        few = ["algo.learning_starts=300", "trainer.episodes=200", f"trainer.steps={steps}"]
        warn_of_late_learning(validate(small_config(tmp_path / "run", *few)))
        assert ("the run ends by then, by trainer.steps=300" in caplog.text) == told


def test_the_guides_action_is_mirrored_with_the_policys_as_it_sees(tmp_path: Path) -> None:
    chosen = ["demonstrator=vfh", "perception=range_image", "perception.last_action=true", "buffer.mirror=true"]
    settings = validate(small_config(tmp_path / "run", *chosen))
    env = make_training_env(settings, seed=0)
    buffer = make_buffer(settings, env, network_sizes(env), torch.device("cpu"))
    (mirror,) = (part for part in inner_transforms(buffer.transform) if isinstance(part, Mirror))
    assert mirror.in_keys[-2:] == ["action", "demonstrator_action"]
    assert (mirror.reduction, mirror.last_action) == ("range_image", True)
    env.close()


@pytest.mark.parametrize("overrides", [["perception.angles=raw"], ["perception.angles=turns"], ["perception=none"]])
def test_a_state_whose_mirror_image_is_unknown_is_not_mirrored(overrides: list[str], tmp_path: Path) -> None:
    settings = validate(small_config(tmp_path / "run", "buffer.mirror=true", *overrides))
    sizes = NetworkSizes(state=105, frames=3, actions=4, limit=2.0)
    with pytest.raises(UavrlError, match=r"^buffer\.mirror must be false, but with uavrl's perception"):
        make_buffer(settings, None, sizes, torch.device("cpu"))  # type: ignore[arg-type]  # it is not looked at


def test_a_guides_costs_can_be_given(tmp_path: Path) -> None:
    costs = "{obstacle: 2, goal: 1, level: 0.3, turn: 0.2, width: 6, nearness: 2, caution: 0.5}"
    config = small_config(tmp_path / "run", "demonstrator=vfh", f"demonstrator.costs={costs}")
    env = make_training_env(validate(config), seed=0)
    assert (env.transform[-1].demonstrator.costs.obstacle, env.transform[-1].demonstrator.costs.caution) == (2.0, 0.5)
    env.close()


def test_imitation_asks_for_a_guide_and_other_penalties_for_single_steps(tmp_path: Path) -> None:
    alone = small_config(tmp_path / "a", "actor_penalty=imitation")
    with pytest.raises(UavrlError, match="demonstrator must be a scripted controller"):
        train(alone, create_run(alone))
    calm = small_config(tmp_path / "b", "algo.n_steps=3")
    calm.packages, calm.actor_penalty = ["tests"], {"_target_": "tests.transforms.test_demonstrator.Calm"}
    with pytest.raises(
        UavrlError, match=r"n_steps must be 1: tests.transforms.test_demonstrator.Calm learns from single"
    ):
        train(calm, create_run(calm))


@pytest.mark.parametrize(("group", "kind"), [("fork", "fork.Fork"), ("lifeguard", "lifeguard.LifeGuard")])
def test_so_do_ours_and_a_variant_says_if_it_does_not(group: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = validate(composed("config", f"{group}={'on' if group == 'fork' else 'linear'}", "algo.n_steps=3"))
    sizes, cpu = NetworkSizes(state=105, frames=3, actions=4, limit=2.0), torch.device("cpu")
    actor = make_actor(settings, sizes)
    with pytest.raises(UavrlError, match=rf"algo.n_steps must be 1: uavrl.losses.{kind} learns from single steps"):
        make_loss(settings, actor, sizes, cpu)
    monkeypatch.setattr(ActorPenalty, "learns_from_single_steps", False)
    assert type(make_loss(settings, actor, sizes, cpu)).__name__ == kind.partition(".")[2]


def test_the_action_rate_asks_for_states_that_end_with_the_last_action() -> None:
    sizes, cpu = NetworkSizes(state=105, frames=3, actions=4, limit=2.0), torch.device("cpu")
    smooth = validate(composed("config", "smoothness=action_rate"))
    wanted = r"perception\.last_action must be true: uavrl\.losses\.action_rate\.ActionRate compares"
    with pytest.raises(UavrlError, match=wanted):
        make_loss(smooth, make_actor(smooth, sizes), sizes, cpu)
    seen = validate(composed("config", "smoothness=action_rate", "perception.last_action=true"))
    loss = make_loss(seen, make_actor(seen, sizes), sizes, cpu)
    assert isinstance(loss, ActionRate) and (loss.actions, loss.limit) == (4, 2.0)


def wide(tensordict: TensorDictBase) -> TensorDictBase:
    return tensordict.set("action", torch.zeros(*tensordict.batch_size, 6))


def lost(tensordict: TensorDictBase) -> TensorDictBase:
    return tensordict.set("action", torch.full((*tensordict.batch_size, 4), torch.nan))


def silent(tensordict: TensorDictBase) -> TensorDictBase:
    return tensordict


def forgotten(tensordict: TensorDictBase) -> None:
    tensordict["action"] = torch.zeros(*tensordict.batch_size, 4)


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (wide, r"got the shape \[2, 6\]"),
        (lost, "got NaN or infinity"),
        (silent, "got none: set it in the TensorDict, and return that"),
        (forgotten, "got none: set it in the TensorDict, and return that"),
    ],
)
def test_a_demonstrator_that_writes_the_wrong_thing_is_named(act: Any, told: str) -> None:
    with pytest.raises(UavrlError, match=rf"^The demonstrator {act.__name__} must write action, .* \[2, 4\], {told}"):
        Demonstrator(act, [], 4)(TensorDict({}, [2]))


def test_what_is_learned_from_is_what_can_be_flown() -> None:
    """Larger actions are cut as the environment cuts them, and are of the policy's precision."""
    far = Demonstrator(lambda state: state.set("action", torch.tensor([[9, -9, 1, 0]])), [], 4, limit=2.0)
    acted = far(TensorDict({}, [1]))["demonstrator_action"]
    assert acted.dtype == torch.float32 and acted.tolist() == [[2.0, -2.0, 1.0, 0.0]]


class Counting(torch.nn.Module):
    """A demonstrator with a memory: its action tells how many observations of the episode it has seen before."""

    def __init__(self) -> None:
        super().__init__()
        self.in_keys, self.out_keys, self.seen = ["is_init"], ["action"], torch.zeros(3, 1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        counts = tensordict.get("_reset", torch.ones_like(tensordict["is_init"]))
        self.seen = torch.where(tensordict["is_init"], 0.0, self.seen + 1) * counts + self.seen * ~counts
        return tensordict.set("action", 0.01 * self.seen.expand(-1, 4))


def test_a_demonstrator_with_a_memory_is_told_who_begins_an_episode() -> None:
    base = NavigationEnv(3, world=SMALL, lidar=NEAR, max_steps=50)
    env = TransformedEnv(base, Compose(InitTracker(), Demonstrator(Counting(), ["is_init"], 4)))
    state, wanted = env.reset(), torch.zeros(3, 1)
    for step in range(12):
        torch.testing.assert_close(state["demonstrator_action"], 0.01 * wanted.expand(-1, 4))
        stepped = env.step(state.set("action", torch.zeros(3, 4)))
        ends = torch.tensor([[step % 3 == 1], [step == 5], [False]])
        stepped["next", "done"], stepped["next", "truncated"] = ends, ends.clone()
        state, wanted = env.maybe_reset(step_mdp(stepped)), torch.where(ends, 0.0, wanted + 1)
    env.close()


def test_a_planner_that_reads_whole_scans_demonstrates_and_no_scan_is_kept(tmp_path: Path) -> None:
    planner = "demonstrator._target_=uavrl.planners.vfh_star.VFHStar"
    with pytest.raises(UavrlError, match=r"demonstrator must be one that has no memory: a planner .*num_uavs=1 alone"):
        make_training_env(validate(small_config(tmp_path / "run", planner, "env.num_uavs=2")), seed=0)
    env = make_training_env(validate(small_config(tmp_path / "run", planner, "env.num_uavs=1")), seed=0)
    state = env.rollout(3)
    assert {"is_init", "demonstrator_action"} <= set(state.keys()) and "point_cloud" not in state.keys(True)
    assert "point_cloud" not in env.observation_spec.keys(True) and state["demonstrator_action"].abs().max() > 0.1
    env.close()


def test_what_a_demonstrator_reads_without_asking_for_it_is_named() -> None:
    env = NavigationEnv(1, world=SMALL, lidar=NEAR)

    def lost(tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", tensordict["way"])

    with pytest.raises(UavrlError, match=r"lost reads an entry that its in_keys do not name \(.*way.*: add it to them"):
        TransformedEnv(env, Demonstrator(lost, [], 4)).reset()
    env.close()
