from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv, check_env_specs

from tests.helpers.contracts import TransformContract
from tests.helpers.flights import small_env
from tests.helpers.small_env import SmallEnv
from uavrl.envs import NavigationEnv
from uavrl.transforms import LastAction, NavigationState, mirror_action, mirror_observation


class TestLastAction(TransformContract):
    def make_transform(self) -> LastAction:
        return LastAction()

    @staticmethod
    def make_env() -> SmallEnv:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        action = torch.rand(*batch, 4, generator=torch.Generator().manual_seed(0))
        return TensorDict({"action": action, "next": TensorDict({}, batch)}, batch)

    def test_vehicles_that_start_anew_have_no_last_action_and_the_others_keep_theirs(self) -> None:
        env = TransformedEnv(SmallEnv(), LastAction())
        state = env.reset().set("action", torch.ones(3, 4))
        state = env.step(state)["next"]
        assert torch.equal(state["last_action"], torch.ones(3, 4))
        again = env.reset(state.set("_reset", torch.tensor([[True], [False], [False]])))
        assert again["last_action"][:, 0].tolist() == [0.0, 1.0, 1.0]

    @pytest.mark.parametrize("keys", [{"in_keys": ["action", "other"]}, {"out_keys": []}])
    def test_one_key_leads_to_one_other(self, keys: dict[str, list[str]]) -> None:
        with pytest.raises(ValueError, match="one in_key and one out_key"):
            LastAction(**keys)


@pytest.fixture(scope="module")
def env() -> TransformedEnv:
    config = small_env()
    return TransformedEnv(NavigationEnv(3, world=config.world, max_steps=8, seed=1), NavigationState(last_action=True))


def test_a_state_ends_each_observation_with_the_action_that_led_to_it(env: TransformedEnv) -> None:
    check_env_specs(env)
    flown = env.rollout(4, break_when_any_done=False)
    frames = flown["next", "observation"].unflatten(-1, (3, 39))  # [3, 4, 3, 39]
    torch.testing.assert_close(frames[:, :, -1, 35:], flown["action"] / 2.0)
    torch.testing.assert_close(frames[:, 1:, -2, 35:], flown["action"][:, :-1] / 2.0)
    assert not flown["observation"][:, 0].unflatten(-1, (3, 39))[:, :, 35:].any()


def test_a_mirror_turns_the_last_actions_too(env: TransformedEnv) -> None:
    flown = env.rollout(4, break_when_any_done=False)
    image = mirror_observation(flown["next", "observation"], last_action=True).unflatten(-1, (3, 39))
    torch.testing.assert_close(image[:, :, -1, 35:], mirror_action(flown["action"]) / 2.0)
    alone = flown["next", "observation"].unflatten(-1, (3, 39))[..., :35]
    torch.testing.assert_close(image[..., :35], mirror_observation(alone))
