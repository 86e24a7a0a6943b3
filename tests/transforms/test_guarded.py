"""Guards around an environment: the heading that policies read, the action that is flown, and resets of some."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv, check_env_specs

from tests.helpers.contracts import ThroughTimeContract
from tests.helpers.flights import small_env
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.rollout import rollout_episodes
from uavrl.transforms import Guarded, LastAction, NavigationReward, NavigationState
from uavrl.transforms.demonstrator import DEMONSTRATOR_ACTION, Demonstrator
from uavrl_onboard.guards.settings import GuardSettings, ShieldSettings
from uavrl_onboard.vehicle import Vehicle

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
        self.action_spec, self.reward_spec = Bounded(-2.0, 2.0, (3, 4)), Unbounded((3, 1))
        self.flown: torch.Tensor | None = None

    def _seen(self) -> TensorDict:
        told = {key: torch.zeros(3, size) for key, size in (("velocity", 3), ("attitude", 3), ("heading_deg", 1))}
        cloud = self.wall.expand(3, -1, -1).clone()
        return TensorDict(told | {"point_cloud": cloud, "altitude": torch.full((3, 1), 3.5)}, (3,))

    def _reset(self, tensordict: TensorDict | None = None, **kwargs: object) -> TensorDict:
        return self._seen()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.flown = tensordict["action"].clone()
        return self._seen().update({"reward": torch.zeros(3, 1), "done": torch.zeros(3, 1, dtype=torch.bool)})

    def _set_seed(self, seed: int | None) -> None:
        pass


def ahead(state: TensorDictBase) -> TensorDictBase:
    """Asks for more speed ahead than there is, and for a turn."""
    return state.set("action", torch.tensor([3.0, 0.0, 0.0, -1.5]).expand(*state.batch_size, 4).clone())


class TestGuarded(ThroughTimeContract):
    def make_transform(self) -> Guarded:
        return Guarded()

    @staticmethod
    def make_env() -> BeforeAWall:
        return BeforeAWall()

    def make_data(self, *batch: int) -> TensorDict:
        cloud = torch.rand(*batch, 30, 3, generator=torch.Generator().manual_seed(0))
        told = {
            "velocity": torch.zeros(*batch, 3),
            "attitude": torch.zeros(*batch, 3),
            "action": torch.zeros(*batch, 4),
        }
        told |= {"altitude": torch.full((*batch, 1), 3.5), "heading_deg": torch.full((*batch, 1), 200.0)}
        return TensorDict({"point_cloud": cloud, **told}, batch)

    def apply(self, transform: Transform, data: TensorDictBase) -> torch.Tensor:
        return transform._call(data)["heading_deg"]

    def test_the_map_turns_the_heading_to_the_walls_nearer_end_and_a_reset_is_of_one_vehicle_alone(self) -> None:
        env = TransformedEnv(BeforeAWall(), Guarded(["map"]))
        state = env.rollout(7)[:, -1]["next"]
        assert ((state["heading_deg"] > 290) & (state["heading_deg"] < 345)).all()  # to the right
        assert not state["goal_heading_deg"].any()
        env.base_env.wall = torch.full_like(env.base_env.wall, torch.nan)
        again = env.reset(state.set("_reset", torch.tensor([[False], [True], [False]])))["heading_deg"]
        assert again[1] == 0.0
        assert torch.equal(again[[0, 2]], state["heading_deg"][[0, 2]])

    def test_the_action_that_is_flown_is_emitted_and_is_the_last_action(self) -> None:
        """The wall is 2 m ahead of the LiDAR: (2 - 0.35 - 0.12) / 1 s is left, and the turn as it was."""
        guards = GuardSettings(shield=ShieldSettings(time=1.0))
        base = BeforeAWall()
        env = TransformedEnv(base, Compose(Guarded(guards), LastAction()))
        state = env.reset()
        assert not state["flown_action"].any() and not state["last_action"].any()
        stepped = env.step(ahead(state))
        assert base.flown is not None and base.flown[0, 0] == pytest.approx(1.53, abs=0.01)
        assert (base.flown[:, 3] == -1.5).all()
        for found in (stepped["next", "flown_action"], stepped["next", "last_action"]):
            assert torch.equal(found, base.flown)
        assert stepped["action"][0].tolist() == [3.0, 0.0, 0.0, -1.5], "what was asked for is kept, too"

    def test_within_its_limits_nothing_changes_without_guards(self) -> None:
        env = TransformedEnv(base := BeforeAWall(), Guarded("none", vehicle=Vehicle(velocity_limit=1.0)))
        env.step(ahead(env.reset()))
        assert base.flown is not None and base.flown[0].tolist() == [1.0, 0.0, 0.0, -1.5]
        assert "goal_heading_deg" not in env.observation_spec

    def test_a_scripted_controller_beside_the_policy_is_led_as_it_is(self) -> None:
        def heads(seen: TensorDictBase) -> TensorDictBase:
            return seen.set("action", seen["heading_deg"])

        env = TransformedEnv(BeforeAWall(), Compose(Guarded("map"), Demonstrator(heads, ["heading_deg"], 1)))
        data = env.rollout(2)["next"]
        assert torch.equal(data[DEMONSTRATOR_ACTION], data["heading_deg"]) and data["heading_deg"].any()

    def test_an_unknown_guard_is_refused(self) -> None:
        with pytest.raises(UavrlError, match="There is no guard 'typo'"):
            Guarded(["map", "typo"])


def test_where_nothing_is_in_the_way_the_heading_is_the_goals_to_the_last_bit() -> None:
    empty = replace(small_env().world, obstacles=0)
    base = NavigationEnv(2, world=empty, lidar=FAR, max_steps=8, seed=1)
    data = TransformedEnv(base, Guarded("map")).rollout(6)["next"]
    assert torch.equal(data["heading_deg"], data["goal_heading_deg"])


def test_in_an_environment_the_specs_hold_and_the_observation_reads_the_turned_heading() -> None:
    base = NavigationEnv(2, world=small_env().world, lidar=FAR, max_steps=8, seed=1)
    env = TransformedEnv(base, Compose(Guarded(), NavigationState(), NavigationReward(heading="goal_heading_deg")))
    check_env_specs(env)
    data = env.rollout(4)["next"]
    expected = (data["heading_deg"] + 180).remainder(360) / 180 - 1
    torch.testing.assert_close(data["observation"][..., -2:-1], expected)


def test_behind_the_shield_the_blind_do_not_collide() -> None:
    world = WorldConfig(size=(16.0, 14.0), obstacles=12, min_goal_distance=5.0, min_clearance=1.0)
    ends = []
    for guards in ("none", "shield"):
        base = NavigationEnv(4, world=world, max_steps=60, measure_clearance=True)
        env = TransformedEnv(base, Guarded(guards))
        ends.append([flight.outcome for flight in rollout_episodes(env, ahead, 4)].count("collided"))
    assert ends[0] > ends[1] == 0
