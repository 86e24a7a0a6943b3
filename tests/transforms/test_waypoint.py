"""The way through a map of the episode, as a transform, in a state, and where a trained policy is evaluated."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, EnvBase, TransformedEnv, check_env_specs

import uavrl
from tests.helpers.commands import in_process
from tests.helpers.contracts import ThroughTimeContract
from tests.helpers.flights import small_env
from uavrl.cli import evaluate as evaluate_command
from uavrl.config import compose, validate
from uavrl.config.settings import EvaluateConfig
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.guarded import GuardedPolicy
from uavrl.evaluation.overrides import with_overrides
from uavrl.evaluation.policies import choose
from uavrl.transforms import NavigationState, Waypoint
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION, Demonstrator

FAR = LidarConfig(max_range=4.0, far_range=12.0)


class BeforeAWall(EnvBase):
    """Three vehicles that hover 2 m before a wall, whose nearer end lies to the right, with the goal behind it."""

    def __init__(self) -> None:
        super().__init__(batch_size=(3,))
        across, up = torch.meshgrid(torch.linspace(-1, 3, 40), torch.linspace(-0.4, 0.2, 5), indexing="ij")
        self.wall = torch.stack([torch.full_like(across, 2.0), across, up], -1).reshape(-1, 3)
        sizes = {"velocity": 3, "attitude": 3, "altitude": 1, "heading_deg": 1}
        told = {key: Unbounded((3, size)) for key, size in sizes.items()}
        self.observation_spec = Composite(point_cloud=Unbounded((3, *self.wall.shape)), **told, shape=(3,))
        self.action_spec, self.reward_spec = Unbounded((3, 1)), Unbounded((3, 1))

    def _seen(self) -> TensorDict:
        told = {key: torch.zeros(3, size) for key, size in (("velocity", 3), ("attitude", 3), ("heading_deg", 1))}
        cloud = self.wall.expand(3, -1, -1).clone()
        return TensorDict(told | {"point_cloud": cloud, "altitude": torch.full((3, 1), 3.5)}, (3,))

    def _reset(self, tensordict: TensorDict | None = None, **kwargs: object) -> TensorDict:
        return self._seen()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        return self._seen().update({"reward": torch.zeros(3, 1), "done": torch.zeros(3, 1, dtype=torch.bool)})

    def _set_seed(self, seed: int | None) -> None:
        pass


class TestWaypoint(ThroughTimeContract):
    def make_transform(self) -> Waypoint:
        return Waypoint()

    @staticmethod
    def make_env() -> BeforeAWall:
        return BeforeAWall()

    def make_data(self, *batch: int) -> TensorDict:
        cloud = torch.rand(*batch, 30, 3, generator=torch.Generator().manual_seed(0))
        told = {"velocity": torch.zeros(*batch, 3), "attitude": torch.zeros(*batch, 3)}
        told |= {"altitude": torch.full((*batch, 1), 3.5), "heading_deg": torch.full((*batch, 1), 200.0)}
        return TensorDict({"point_cloud": cloud, **told}, batch)

    def test_five_keys_lead_to_one(self) -> None:
        with pytest.raises(ValueError, match="five in_keys"):
            Waypoint(in_keys=["point_cloud"])

    @pytest.mark.parametrize("wrong", [(0.0, 0.1), (0.0, 0.0, torch.nan)])
    def test_a_sensor_is_somewhere(self, wrong: tuple[float, ...]) -> None:
        with pytest.raises(ValueError, match="three finite numbers in m: forward, left, up; got"):
            Waypoint(sensor_position=wrong)

    def test_a_wall_turns_the_heading_to_its_nearer_end_and_a_reset_is_of_one_vehicle_alone(self) -> None:
        env = TransformedEnv(BeforeAWall(), Waypoint())
        state = env.rollout(7)[:, -1]["next"]
        assert ((state["waypoint_deg"] > 290) & (state["waypoint_deg"] < 345)).all()  # to the right
        assert not state["heading_deg"].any()
        env.base_env.wall = torch.full_like(env.base_env.wall, torch.nan)
        again = env.reset(state.set("_reset", torch.tensor([[False], [True], [False]])))["waypoint_deg"]
        assert again[1] == 0.0
        assert torch.equal(again[[0, 2]], state["waypoint_deg"][[0, 2]])


def test_where_nothing_is_in_the_way_the_heading_is_the_goals_to_the_last_bit() -> None:
    empty = replace(small_env().world, obstacles=0)
    base = NavigationEnv(2, world=empty, lidar=FAR, max_steps=8, seed=1)
    data = TransformedEnv(base, Waypoint()).rollout(6)["next"]
    assert torch.equal(data["waypoint_deg"], data["heading_deg"])


def test_a_state_with_memory_reads_the_waypoint_where_it_read_the_goal() -> None:
    state = NavigationState(memory=12.0)
    env = TransformedEnv(NavigationEnv(2, world=small_env().world, lidar=FAR, max_steps=8, seed=1), state)
    check_env_specs(env)
    data = env.rollout(4)["next"]
    expected = (data["waypoint_deg"] + 180).remainder(360) / 180 - 1
    torch.testing.assert_close(data["observation"][..., -2:-1], expected)


def test_a_trained_policy_can_be_given_a_memory(tmp_path: Path) -> None:
    output, world = tmp_path / "result.json", ["env=static", "valleys=[100]", "env.world.obstacles=20"]
    told = ["policy=best", "perception.memory=12", *world, "episodes=1", f"output={output}", "progress=false"]
    assert in_process(evaluate_command.main, *told) == 0
    assert "perception.memory=12" in json.loads(output.read_text())["overrides"]
    env = uavrl.load_policy("best").make_env("perception.memory=12", "env.world.obstacles=20")
    assert {"waypoint_deg", "heading_deg"} <= set(env.reset().keys())


@pytest.mark.parametrize("policy", ["vfh", "mppi"])
def test_a_policy_that_reads_the_goal_itself_is_shown_the_waypoint(policy: str) -> None:
    chosen = [f"policy={policy}", "perception=range_image", "perception.memory=12"]
    config = compose(*chosen, name="evaluate")
    setup = choose(validate(config, EvaluateConfig), config, chosen, None, torch.device("cpu"))
    assert (
        isinstance(setup.policy, GuardedPolicy)
        and setup.policy.led
        and {"waypoint_deg", "heading_deg"} <= set(setup.policy.in_keys)
    )


def test_a_memory_for_somebody_elses_perception_is_refused() -> None:
    run = compose("perception=none")
    composed = compose("perception.memory=12", name="evaluate")
    with pytest.raises(UavrlError, match=r"the policy's perception is none: leave perception\.memory out"):
        with_overrides(run, composed, ["perception.memory=12"])


@pytest.mark.parametrize(("stored", "given", "reaches"), [(12, 20, None), (30, 20, 30), (None, 20, None)])
def test_a_run_that_looked_farther_keeps_its_sensor(stored: float | None, given: float, reaches: float | None) -> None:
    run = compose(f"perception.lidar.far_range={'null' if stored is None else stored}")
    told = f"perception.memory={given}"
    changed = with_overrides(run, compose(told, name="evaluate"), [told])
    assert changed.perception.lidar.far_range == reaches


def test_a_scripted_controller_beside_the_policy_is_led_as_it_is() -> None:
    env = TransformedEnv(BeforeAWall(), Compose(Waypoint(), Demonstrator(_heads, ["heading_deg"], 1)))
    data = env.rollout(2)["next"]
    assert torch.equal(data[DEMONSTRATOR_ACTION], data["waypoint_deg"]) and not data["heading_deg"].any()


def _heads(seen: TensorDictBase) -> TensorDictBase:
    return seen.set("action", seen["heading_deg"])


def test_a_policy_that_sees_motion_may_remember_farther_than_it_looked() -> None:
    env = uavrl.load_policy("best_dynamic").make_env("perception.memory=20", "env.world.obstacles=5")
    assert env.base_env._lidar_config.far_range == 20.0
    env.close()
