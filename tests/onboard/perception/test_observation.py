"""The observation and the state in numpy against those in PyTorch."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import torch
from torchrl.envs import CatFrames, TransformedEnv

from tests.helpers.clouds import CloudEnv
from uavrl.transforms import navigation_observation as in_torch
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.perception.goal import goal_elevation_deg, goal_heading_deg
from uavrl_onboard.perception.observation import FrameStack, navigation_observation


@pytest.mark.parametrize("angles", ["folded", "turns", "raw"])
def test_observations_are_those_of_torch(angles: Literal["folded", "turns", "raw"]) -> None:
    rng = np.random.default_rng(0)
    cells = rng.uniform(0, 4, (1000, 32)).astype(np.float32)
    rest = rng.uniform([0, 0, 0], [8, 360, 360], (1000, 3)).astype(np.float32)
    rest[:4, 1:] = [[0, 180], [180, 0], [359.99997, 90], [270, 36]]
    theirs = in_torch(
        torch.from_numpy(cells), *torch.from_numpy(rest)[:, :, None].unbind(1), radius=5.0, flight_level=3.0,
        angles=angles,
    ).numpy()  # fmt: skip
    ours = [
        navigation_observation(each, *map(float, row), radius=5.0, flight_level=3.0, angles=angles)
        for each, row in zip(cells, rest, strict=True)
    ]
    assert ours[0].dtype == np.float32
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


def test_an_unknown_scaling_is_refused() -> None:
    with pytest.raises(UavrlError, match="angles must be one of folded, turns, raw, got 'degrees'"):
        navigation_observation(np.zeros(32), 1.0, 0.0, 0.0, angles="degrees")  # type: ignore[arg-type]


@pytest.mark.parametrize("frames", [1, 3])
def test_frames_stand_as_training_stacks_them(frames: int) -> None:
    stack = CatFrames(frames, dim=-1, in_keys=["cloud"], padding="constant", padding_value=0.0)
    env, state = TransformedEnv(CloudEnv(key="cloud"), stack), FrameStack(frames)
    for episode in range(2):
        state.reset()
        stacked = env.rollout(5)["cloud"][:, 0].numpy()  # of the first point, [5, 3 * frames]
        for expected in stacked:
            np.testing.assert_array_equal(state(expected[-3:]), expected, err_msg=f"episode {episode}")
        assert stacked[-1].all() and (frames == 1 or not stacked[0, : 3 * frames - 3].any())


def test_the_last_action_stands_behind_each_observation_scaled() -> None:
    state = FrameStack(frames=2, last_action=True)
    assert state(np.array([1.0])).tolist() == [0.0] * 5 + [1.0, 0.0, 0.0, 0.0, 0.0]
    action = np.array([2.0, -1.0, 0.5, -2.0])
    assert state(np.array([3.0]), action).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 3.0, 1.0, -0.5, 0.25, -1.0]


def test_the_goal_s_angles_are_the_environment_s() -> None:
    position, goal = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 4.0, 2.0]])
    assert goal_heading_deg(position, np.array([0.0]), goal).tolist() == [90.0]
    assert goal_heading_deg(position, np.array([np.pi / 2]), goal).tolist() == [0.0]
    assert goal_elevation_deg(position, goal + np.array([0, 0, 4])).tolist() == [45.0]
