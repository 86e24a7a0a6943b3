from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import tensor
from torchrl.envs import CatFrames, Compose, TransformedEnv

from tests.helpers.contracts import TransformContract
from tests.helpers.small_env import SmallEnv
from uavrl.transforms import NavigationObservation, navigation_observation
from uavrl.transforms.observation import Angles


class TestNavigationObservation(TransformContract):
    def make_transform(self) -> NavigationObservation:
        return NavigationObservation()

    @staticmethod
    def make_env() -> SmallEnv:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        generator = torch.Generator().manual_seed(0)
        keys = ("altitude", "heading_deg", "elevation_deg")
        data = {key: 360 * torch.rand(*batch, 1, generator=generator) for key in keys}
        return TensorDict({"faces": torch.rand(*batch, 32, generator=generator), **data}, batch)

    def test_literal_values(self) -> None:
        faces = torch.zeros(32)
        faces[3] = 1.0
        o = navigation_observation(faces, tensor([1.75]), tensor([90.0]), tensor([315.0]))
        assert o.shape == (35,)
        assert o[3] == 0.25
        assert o[32:].tolist() == [-0.5, 0.5, -0.25]

    def test_folded_angles_do_not_jump_where_the_uav_faces_the_goal(self) -> None:
        angles = tensor([[359.0], [0.0], [1.0]])
        o = navigation_observation(torch.zeros(3, 32), torch.zeros(3, 1), angles, angles)
        torch.testing.assert_close(o[:, 33], tensor([-1.0, 0.0, 1.0]) / 180)

    @pytest.mark.parametrize(("angles", "read"), [("raw", [0.0, 270.0, 36.0]), ("turns", [0.0, 0.75, 0.1])])
    def test_raw_angles_stay_degrees_and_turns_make_them_small(self, angles: Angles, read: list[float]) -> None:
        o = navigation_observation(torch.zeros(32), tensor([3.5]), tensor([270.0]), tensor([36.0]), angles=angles)
        torch.testing.assert_close(o[32:], tensor(read))
        with pytest.raises(ValueError, match="folded"):
            NavigationObservation(angles="degrees")  # type: ignore[arg-type]

    def test_a_partial_reset_clears_the_frames_of_that_body_alone(self) -> None:
        frames = CatFrames(3, dim=-1, in_keys=["observation"], padding="constant", padding_value=0.0)
        env = TransformedEnv(SmallEnv(), Compose(NavigationObservation(), frames))
        state = env.reset()
        for _ in range(3):
            state["action"] = torch.ones(3, 4)
            state = env.step(state)["next"]
        before = state["observation"].clone()
        state["_reset"] = tensor([[False], [True], [False]])
        after = env.reset(state)["observation"]
        assert torch.equal(after[[0, 2]], before[[0, 2]])
        assert not after[1, :70].any()
        assert after[1, 70:].any()
