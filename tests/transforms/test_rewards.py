from __future__ import annotations

import pytest
import torch
from tensordict import NestedKey, TensorDict
from torch import tensor
from torchrl.envs import TransformedEnv, check_env_specs

from tests.helpers.contracts import TransformContract
from tests.helpers.small_env import SmallEnv
from uavrl.transforms import NavigationReward, TraditionalReward, navigation_reward, traditional_reward
from uavrl.transforms.rewards import SumOfTerms, fold_degrees


def transitions(*batch: int) -> TensorDict:
    generator = torch.Generator().manual_seed(0)

    def uniform(high: float) -> torch.Tensor:
        return high * torch.rand(*batch, 1, generator=generator)

    def frame() -> dict[str, torch.Tensor]:
        angles = {"heading_deg": uniform(360), "elevation_deg": uniform(360)}
        flags = {"arrived": uniform(1) > 0.7, "collided": uniform(1) > 0.7}
        return {"distance": uniform(20), "altitude": uniform(7), **angles, **flags}

    return TensorDict({**frame(), "next": {**frame(), "reward": uniform(1)}}, batch)


class OfTransitions:
    @staticmethod
    def make_env() -> SmallEnv:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        return transitions(*batch)


class TestTraditionalReward(OfTransitions, TransformContract):
    def make_transform(self) -> TraditionalReward:
        return TraditionalReward()

    def test_literal_values(self) -> None:
        """Eq. 2.15 by hand: progress 5 - 4.25; the prize; the punishment; a collision beats an arrival."""
        reward = traditional_reward(
            tensor([5.0, 5.0, 5.0, 5.0]),
            tensor([4.25, 0.5, 5.5, 0.5]),
            tensor([False, True, False, True]),
            tensor([False, False, True, True]),
        )
        assert reward.tolist() == [0.75, 50.0, -50.0, -50.0]


class TestNavigationReward(OfTransitions, TransformContract):
    def make_transform(self) -> NavigationReward:
        return NavigationReward()

    @pytest.mark.parametrize(
        ("altitude", "heading", "elevation", "collided", "expected"),
        [
            (3.5, 0.0, 0.0, False, 8 * 0.5 + 1 + 0.5 + 0.5),
            (7.0, 0.0, 0.0, False, 8 * 0.5 + 0 + 0.5 + 0.5),
            (0.0, 0.0, 0.0, False, 8 * 0.5 + 0 + 0.5 + 0.5),
            (3.5, 180.0, 0.0, False, 8 * 0.5 + 1 + 0 + 0.5),
            (3.5, 270.0, 315.0, False, 8 * 0.5 + 1 + 0.25 + 0.375),
            (3.5, 0.0, 0.0, True, -50.0),
        ],
    )
    def test_literal_values(
        self, altitude: float, heading: float, elevation: float, collided: bool, expected: float
    ) -> None:
        """Eq. 3.6 by hand with w = (8, 1, 0.5, 0.5), p = 3.5 and half a metre of progress."""
        flown = (5.0, 4.5, altitude, heading, elevation, False, collided)
        reward = navigation_reward(*map(tensor, flown))
        assert reward.item() == pytest.approx(expected)

    def test_the_arrival_pays_only_where_it_is_asked_to(self) -> None:
        args = tensor(5.0), tensor(4.5), tensor(3.5), tensor(0.0), tensor(0.0), tensor(True)
        assert navigation_reward(*args, tensor(False)).item() == 6.0
        assert navigation_reward(*args, tensor(False), arrived_reward=200.0).item() == 206.0
        assert navigation_reward(*args, tensor(True), arrived_reward=200.0).item() == -50.0

    def test_the_literal_altitude_term_pays_twice_on_the_ground(self) -> None:
        args = tensor(5.0), tensor(5.0), tensor(0.0), tensor(180.0), tensor(180.0), tensor(False), tensor(False)
        assert navigation_reward(*args).item() == 0.0
        assert navigation_reward(*args, altitude_term="literal").item() == 2.0

    def test_in_an_environment_it_sees_the_step_before(self) -> None:
        env = TransformedEnv(SmallEnv(), NavigationReward())
        state = env.reset()
        state["action"] = torch.ones(3, 4)
        after = env.step(state)["next"]
        assert after["distance"].tolist() == [[pytest.approx(4.9)]] * 3
        heading = 49.0  # small_env: ten degrees a metre
        assert after["reward"].tolist() == [[pytest.approx(0.8 + 1 + 0.5 * (1 - heading / 180) + 0.5, abs=1e-5)]] * 3

    @pytest.mark.parametrize("kwargs", [{"weights": (1.0, 2.0)}, {"altitude_term": "cubed"}])
    def test_bad_settings_are_refused(self, kwargs: dict[str, object]) -> None:
        with pytest.raises(ValueError, match=next(iter(kwargs)).split("_")[0]):
            NavigationReward(**kwargs)

    def test_a_missing_key_is_named(self) -> None:
        data = transitions(2)
        del data["next", "altitude"]
        with pytest.raises(KeyError, match="altitude"):
            NavigationReward()(data)


def test_angles_fold_to_their_size() -> None:
    assert fold_degrees(tensor([0.0, 180.0, 181.0, 359.0, 360.0])).tolist() == [0.0, 180.0, 179.0, 1.0, 0.0]


@pytest.mark.parametrize("key", ["reward", "shaped", ("agent", "reward")])
@pytest.mark.parametrize("transform", [NavigationReward, TraditionalReward])
def test_the_reward_goes_where_it_is_wanted(transform: type, key: NestedKey) -> None:
    env = TransformedEnv(SmallEnv(), transform(out_key=key))
    check_env_specs(env)
    assert key in env.reward_keys
    flown = env.rollout(3)
    assert torch.equal(flown["next"].get(key), transform()(flown.clone())["next", "reward"])


@pytest.mark.parametrize(
    "reward",
    [
        NavigationReward(arrived_reward=200.0),
        NavigationReward((3.0, 2.0, 1.0, 0.5), altitude_term="literal", collided_reward=-10.0),
        TraditionalReward(),
    ],
    ids=["prize", "literal", "traditional"],
)
def test_the_reward_is_the_sum_of_its_terms_and_a_collision_alone_counts(reward: SumOfTerms) -> None:
    steps = transitions(200)
    terms = reward.terms(steps, steps["next"])
    collided = steps["next", "collided"]
    assert collided.any() and (steps["next", "arrived"] & collided).any()
    paid = reward(steps)["next", "reward"]
    torch.testing.assert_close(torch.stack(list(terms.values())).sum(0), paid)
    assert (paid[collided] == reward.collided_reward).all()
    assert all((term[collided] == 0).all() for name, term in terms.items() if name != "collision")
