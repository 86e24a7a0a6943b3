from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv, check_env_specs

from tests.helpers.contracts import ThroughTimeContract
from tests.helpers.flights import small_env
from tests.helpers.moving import BODY, ScanEnv, Vehicle, straight, valley
from uavrl.config import compose, validate
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env, with_sight
from uavrl.training.build import _make_mirror
from uavrl.transforms import MotionSight, MovingObjects, NavigationState, mirror_observation

FAR = LidarConfig(max_range=4.0, far_range=12.0)


@pytest.fixture(scope="module")
def lidar() -> Lidar:
    return Lidar(valley(), BODY, FAR)


@pytest.mark.parametrize("heading", [90.0, 135.0, 180.0, 225.0])
def test_a_body_8_m_away_is_reported_with_its_velocity(lidar: Lidar, heading: float) -> None:
    way = straight((8.0, 0.5, 0.3), 3.5, math.radians(heading), 10)
    seen = Vehicle().seen(lidar, way)[:, 0]
    velocity = np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading)), 0.0]) * 3.5
    assert (seen[4:, 6] > 0.3).all()
    assert (np.linalg.norm(seen[5:, 3:6] - velocity, axis=-1) < 0.5).all(), seen[:, 3:6]
    places = np.array([pose[0, :3] for pose in way])
    assert (np.linalg.norm(seen[4:, :3] - places[4:], axis=-1) < 0.6).all()


def test_fixed_errors_of_attitude_and_noise_of_velocity_leave_a_body_found(lidar: Lidar) -> None:
    way = straight((8.0, 0.5, 0.3), 3.5, math.pi, 10)
    seen = Vehicle().seen(lidar, way, noisy=True)
    errors = np.linalg.norm(seen[6:, 0, 3:6] - [-3.5, 0.0, 0.0], axis=-1)
    assert (seen[6:, 0, 6] > 0.3).all() and (errors < 0.7).all(), errors


def test_what_stands_is_not_reported_by_a_vehicle_that_moves_turns_and_tilts(lidar: Lidar) -> None:
    assert not Vehicle().seen(lidar, [np.zeros((0, 4))] * 40).any()


def test_what_stands_is_not_reported_where_attitudes_are_wrong(lidar: Lidar) -> None:
    assert not Vehicle().seen(lidar, [np.zeros((0, 4))] * 40, wrong=(1.0, 1.0, 2.0)).any()


def test_a_body_is_reported_where_attitudes_are_wrong(lidar: Lidar) -> None:
    way = straight((8.0, 0.5, 0.3), 3.5, math.pi, 10)
    seen = Vehicle().seen(lidar, way, wrong=(1.0, 1.0, 2.0))
    errors = np.linalg.norm(seen[6:, 0, 3:6] - [-3.5, 0.0, 0.0], axis=-1)
    assert (seen[6:, 0, 6] > 0.3).all() and (errors < 0.7).all(), errors


def test_a_sector_that_never_sees_is_not_free(lidar: Lidar) -> None:
    """What turns out of it has not come there."""
    vehicle, sight = Vehicle(), MotionSight(1)
    for cloud, _, attitude in vehicle.scans(lidar, iter([np.zeros((0, 4))] * 30)):
        cycles = cloud.reshape(1, 1808, 16, 3)[:, ::5].copy()
        cycles[:, 60:110] = np.nan
        assert not sight.look(cycles.reshape(1, -1, 3), vehicle.velocity[None], attitude[None]).any()


def test_a_body_that_stands_or_crawls_is_not_reported(lidar: Lidar) -> None:
    assert not Vehicle().seen(lidar, straight((6.0, 0.0, 0.5), 0.0, 0.0, 15)).any()
    assert not Vehicle().seen(lidar, straight((6.0, 0.0, 0.5), 0.6, 1.57, 15)).any()


def test_a_body_behind_a_wall_is_not_seen(lidar: Lidar) -> None:
    assert not Vehicle().seen(lidar, straight((6.0, -11.0, 0.5), 3.0, 0.0, 10)).any()


def test_the_nearest_come_first(lidar: Lidar) -> None:
    near, far = straight((6.0, -2.0, 0.3), 3.0, 1.57, 10), straight((-8.0, 0.0, 0.3), 3.0, 1.57, 10)
    seen = Vehicle().seen(lidar, [np.concatenate(pair) for pair in zip(near, far, strict=True)])
    assert (np.linalg.norm(seen[-1, :2, :3] - [near[-1][0, :3], far[-1][0, :3]], axis=-1) < 0.6).all()
    alone = Vehicle().seen(
        lidar, [np.concatenate(pair) for pair in zip(near, far, strict=True)], MotionSight(1, objects=1)
    )
    assert np.allclose(alone[-1, 0], seen[-1, 0])


def test_a_scan_whose_other_rays_are_cut_shows_the_same_objects() -> None:
    full, cut = Lidar(valley(), BODY, LidarConfig(max_range=12.0)), Lidar(valley(), BODY, FAR)
    way = straight((7.0, 0.5, 0.3), 3.5, 2.3, 6)
    assert np.array_equal(Vehicle().seen(full, way), Vehicle().seen(cut, way))


class TestMovingObjects(ThroughTimeContract):
    def make_transform(self) -> MovingObjects:
        return MovingObjects()

    @staticmethod
    def make_env() -> ScanEnv:
        return ScanEnv()

    def make_data(self, *batch: int) -> TensorDict:
        cloud = torch.rand(*batch, 30, 3, generator=torch.Generator().manual_seed(0))
        return TensorDict(
            {"point_cloud": cloud, "velocity": torch.zeros(*batch, 3), "attitude": torch.zeros(*batch, 3)}, batch
        )

    def test_objects_are_reported_and_a_reset_forgets_those_of_one_vehicle_alone(self) -> None:
        env = TransformedEnv(ScanEnv(), MovingObjects())
        state = env.rollout(8)[:, -1]["next"]
        objects = state["moving_objects"].unflatten(-1, (3, 7))
        torch.testing.assert_close(objects[:, 0, :3], torch.tensor([[6.0, 2.4, 0.0]]).expand(3, 3), atol=0.1, rtol=0)
        torch.testing.assert_close(objects[:, 0, 3:6], torch.tensor([[0.0, 3.0, 0.0]]).expand(3, 3), atol=0.3, rtol=0)
        assert not objects[:, 1:].any()
        again = env.reset(state.set("_reset", torch.tensor([[False], [True], [False]])))["moving_objects"]
        assert not again[1].any()
        assert torch.equal(again[[0, 2]], state["moving_objects"][[0, 2]])

    @pytest.mark.parametrize("wrong", [{"max_range": 0.0}, {"objects": 0}, {"every": 0}, {"period": -0.1}])
    def test_values_above_0(self, wrong: dict[str, float]) -> None:
        with pytest.raises(ValueError, match="above 0"):
            MovingObjects(**wrong)

    def test_three_keys_lead_to_one(self) -> None:
        with pytest.raises(ValueError, match="three in_keys"):
            MovingObjects(in_keys=["point_cloud"])


def test_a_state_holds_the_objects_before_the_last_action_and_a_mirror_turns_them() -> None:
    env = TransformedEnv(
        NavigationEnv(2, world=small_env(planes=2).world, lidar=FAR, max_steps=8, seed=1),
        NavigationState(motion=12.0, last_action=True),
    )
    check_env_specs(env)
    data = env.rollout(3)["next"]
    frame = data["observation"].unflatten(-1, (3, 133))[..., -1, :]
    scale = torch.tensor([12.0] * 3 + [5.0] * 3 + [2.5]).repeat(3)
    torch.testing.assert_close(frame[..., 35:56] * scale, data["moving_objects"])
    seen = torch.zeros(35 + 21 + 73 + 4)
    seen[35:42] = torch.tensor([0.5, 0.2, 0.1, 0.3, -0.4, 0.05, 0.4])
    seen[33], seen[129:] = -1.0, torch.tensor([0.5, 0.25, 0.0, 1.0])
    image = mirror_observation(seen, last_action=True, motion=True)
    torch.testing.assert_close(image[35:42], torch.tensor([0.5, -0.2, 0.1, 0.3, 0.4, 0.05, 0.4]))
    assert image[33] == -1.0 and image[129:].tolist() == [0.5, -0.25, 0.0, -1.0]
    assert torch.equal(mirror_observation(image, last_action=True, motion=True), seen)


def test_the_buffers_mirror_is_told_of_them() -> None:
    chosen = ["perception=range_image", "perception.motion=12", "buffer.mirror=true"]
    assert _make_mirror(validate(compose(*chosen))).motion
    assert not _make_mirror(validate(compose("buffer.mirror=true"))).motion


@pytest.mark.parametrize(
    ("chosen", "reaches"),
    [
        ([], None),
        (["perception.motion=12"], 12.0),
        (["perception.motion=8", "perception.lidar.far_range=20"], 20.0),
    ],
)
def test_the_sensor_looks_as_far_as_perception_does(chosen: list[str], reaches: float | None) -> None:
    assert with_sight(validate(compose(*chosen)).perception)["lidar"].far_range == reaches


@pytest.mark.parametrize("motion", [3, 12])
def test_a_sensor_that_reaches_as_far_without_it_will_do(motion: int) -> None:
    """With a LiDAR of 20 m no firing cycle need look farther, nor with sight that ends before the cells."""
    seen = validate(compose(f"perception.motion={motion}", "perception.lidar.max_range=20")).perception
    env = make_env(small_env(), seen, num_uavs=1)
    assert env.rollout(2)["observation"].shape == (1, 2, 3 * (35 + 21 + 73))
    env.close()


def test_looking_farther_than_the_sensor_reaches_is_refused() -> None:
    """What is not scanned would seem to be free, and all that comes into range to move."""
    seen = validate(compose("perception.motion=12", "perception.lidar.far_range=8")).perception
    with pytest.raises(UavrlError, match=r"perception\.motion=12 looks farther than the LiDAR, which reaches 8 m"):
        make_env(small_env(), seen)
