"""The literature's learners come through the open door: their own parts, trained, resumed and used."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from tests.helpers.commands import TINY, in_process
from uavrl.cli.evaluate import main as evaluate
from uavrl.cli.train import main as train
from uavrl.config import compose, validate
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import read_policy
from uavrl_onboard.vehicle import VEHICLE

LEARNERS = Path(__file__).resolve().parents[1] / "learners"
DOOR = ["--config-dir", str(LEARNERS / "conf")]
PACKAGE = "packages=[learners]"


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(LEARNERS)


# ------------------------------------------------------------------------------------- two pools


def transitions(first: int, count: int) -> TensorDict:
    """Steps whose reward is their number."""
    numbers = torch.arange(first, first + count).float()[:, None]
    last = torch.zeros(count, 1, dtype=torch.bool)
    after = {"observation": numbers + 1, "reward": numbers, "done": last, "terminated": last}
    return TensorDict({"observation": numbers, "next": after}, [count])


@pytest.mark.parametrize(("stored", "pilots"), [(60, 100), (100, 100), (200, 75), (300, 50), (500, 0), (700, 0)])
def test_the_pilots_share_falls_from_all_to_none(stored: int, pilots: int) -> None:
    from learners.two_pools import TwoPoolsBuffer

    buffer = TwoPoolsBuffer(1000, pilot_steps=100, until=500)
    buffer.extend(transitions(0, stored))
    for batch in buffer.sample(3200).split(100):  # as the loop draws them
        assert int((batch["next", "reward"] < 100).sum()) == pytest.approx(pilots, abs=1)
    drawn = set(buffer.sample(20_000)["next", "reward"].flatten().int().tolist())
    assert drawn == set(range(0 if pilots else 100, 100 if pilots == 100 and stored > 100 else stored))


def test_pools_that_cannot_be_told_apart_are_refused() -> None:
    from learners.two_pools import TwoPoolsBuffer

    for until in (100, 1001):
        with pytest.raises(UavrlError, match="until must be above pilot_steps, 100, and no more than capacity, 1000"):
            TwoPoolsBuffer(1000, pilot_steps=100, until=until)


# ------------------------------------------------------------------------- the alternative action


class Values(torch.nn.Module):
    """The more the action agrees with the state's first number, the better."""

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return observation[..., :1] * action[..., :1]


class Always(torch.nn.Module):
    """One action."""

    def __init__(self, action: float) -> None:
        super().__init__()
        self.action, self.last_action, self.radius, self.vehicle = action, False, 4.0, VEHICLE

    def forward(self, seen: torch.Tensor | TensorDict) -> torch.Tensor | TensorDict:
        if isinstance(seen, torch.Tensor):
            return torch.full((*seen.shape[:-1], 4), self.action)
        return seen.set("action", torch.full((*seen.shape, 4), self.action))


def test_the_alternative_is_taken_exactly_where_it_is_worth_more() -> None:
    from learners.alternative import GreaterValue, TwoActions

    policy = GreaterValue(TwoActions(Always(-1.0), Values(), Always(1.0), observations=10, actions=4, stacked=2))
    states = torch.zeros(2, 3, 10)
    states[..., 0] = torch.tensor([[1.0, -1.0, 0.0], [-2.0, 3.0, 0.5]])
    acted = policy(TensorDict({"observation": states}, [2, 3]))["action"]
    assert acted.shape == (2, 3, 4)
    assert acted[..., 0].tolist() == [[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0]]  # the actor's where both are worth the same
    assert policy.counted.tolist() == [3.0, 6.0]


@pytest.mark.parametrize("last_action", [False, True])
def test_the_controller_does_from_the_state_what_it_does_from_the_scan(last_action: bool) -> None:
    from learners.alternative import TwoActions
    from torchrl.envs import TransformedEnv

    from uavrl.envs import NavigationEnv
    from uavrl.envs.world import WorldConfig
    from uavrl.policies.baselines import VectorFieldHistogram
    from uavrl.transforms import NavigationState

    world = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=4.0)
    base = NavigationEnv(3, world=world)
    env = TransformedEnv(base, NavigationState(reduction="range_image", last_action=last_action))
    vfh = VectorFieldHistogram(reduction="range_image", last_action=last_action)
    width = env.observation_spec["observation"].shape[-1]
    both = TwoActions(Always(0.0), Values(), vfh, observations=width, actions=4, stacked=3)
    try:
        flown = env.rollout(12, vfh, break_when_any_done=False)
    finally:
        env.close()
    assert flown["action"].abs().max() > 0.5
    torch.testing.assert_close(both.alternative(flown["observation"]), flown["action"], atol=1e-3, rtol=0)


# ------------------------------------------------------------------------------------ whole runs


def short(run: Path, learner: str) -> list[str]:
    own = ["buffer.until=80"] if learner == "mep_ddpg" else []
    chosen = [f"learner={learner}", "perception=range_image", PACKAGE, f"run_dir={run}", *TINY]
    return [*DOOR, *chosen, *own, "trainer.episodes=8"]


@pytest.mark.parametrize("learner", ["mep_ddpg", "td3_alternative"])
def test_a_learner_trains_goes_on_and_is_evaluated(learner: str, tmp_path: Path) -> None:
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    assert in_process(train, *short(whole, learner)) == 0
    assert in_process(train, *short(halved, learner), "trainer.episodes=4") == 0
    assert in_process(train, f"resume={halved}", PACKAGE, "trainer.episodes=8") == 0
    one, other = (read_policy(run, packages=["learners"]).actor for run in (whole, halved))
    assert all(torch.equal(*pair) for pair in zip(one.parameters(), other.parameters(), strict=True))
    assert json.loads((whole / "summary.json").read_text())["updates"] > 80
    assert in_process(evaluate, f"run={halved}", PACKAGE, "episodes=2", "progress=false") == 0


def test_two_pools_need_a_pilot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process(train, *short(tmp_path / "run", "ddpg"), "buffer=two_pools", "buffer.until=80") == 1
    assert "The buffer reads 'demonstrator_action'" in capsys.readouterr().err


def test_the_policy_that_is_used_has_the_critic_that_was_learned(tmp_path: Path) -> None:
    assert in_process(train, *short(tmp_path / "run", "td3_alternative")) == 0
    network = read_policy(tmp_path / "run", packages=["learners"]).actor.network
    states = torch.rand(50, network.width * 3)
    own, other = network(states), network.alternative(states)
    better = (network.critic(states, other) > network.critic(states, own)).squeeze(-1)
    policy = read_policy(tmp_path / "run", packages=["learners"])
    acted = policy(TensorDict({"observation": states}, [50]))["action"]
    assert torch.equal(acted, torch.where(better[:, None], other, own))


# ------------------------------------------------------------------------------------- the study


def test_all_learners_are_trained_in_the_same_way(said: Callable[..., str], tmp_path: Path) -> None:
    import rival_learners

    found = {}
    for learner in rival_learners.LEARNERS:
        words = rival_learners.training(learner, 0, tmp_path)[4:]
        assert words[:2] == ["--config-dir", str(LEARNERS / "conf")]
        found[learner] = validate(compose(*words[2:], own=[LEARNERS / "conf"]))
    assert {run.trainer.steps for run in found.values()} == {20_000}
    assert {run.algo.learning_starts for run in found.values()} == {4_000}
    buffer = found["mep_ddpg"].buffer
    assert (buffer.pilot_steps, buffer.until) == (4_000, 10_000) and found["mep_ddpg"].demonstrated
    assert found["td3_alternative"].algo.actor["_target_"] == "learners.alternative.TwoActions"


def test_what_was_flown_is_told(said: Callable[..., str], tmp_path: Path) -> None:
    run = tmp_path / "td3_seed3"
    (run / "suite").mkdir(parents=True)
    world = {"episodes": 4, "outcomes": "SCCT", "steps_per_arrival": 100.0, "seed": 20_000}
    (run / "suite/suite.json").write_text(json.dumps({"static": world, "held_out": {**world, "outcomes": "SSSS"}}))
    ended = {"steps": 20_050, "updates": 16_000, "versions": {"commit": "0123456"}}
    (run / "summary.json").write_text(json.dumps(ended))
    told = said("rival_learners", tmp_path, "--only-read", "--seeds", 3, "--json", tmp_path / "found.json")
    assert "| td3, 3 | 25.0 (4.6–69.9) | 50.0 | 100.0 (51.0–100.0) | 0.0 |" in told
    assert json.loads((tmp_path / "found.json").read_text())["td3_seed3"]["commit"] == "0123456"
    import rival_learners

    assert rival_learners.training("td3", 3, run) == []  # it has ended
