from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, ReplayBuffer, Unbounded
from torchrl.envs import EnvBase, TransformedEnv, check_env_specs

from tests.helpers.contracts import TransformContract
from tests.helpers.flights import small_env
from tests.helpers.scenes import box, terrain
from tests.helpers.small_env import SmallEnv
from uavrl.attitude import body_to_world
from uavrl.config import compose, validate_run
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.mesh import Mesh
from uavrl.errors import UavrlError
from uavrl.rollout.environment import make_env
from uavrl.training.build import _make_mirror
from uavrl.transforms import MotionSight, MovingObjects, NavigationState, mirror_observation

BODY = box((0.0, 0.0, 0.0), (0.8, 0.8, 0.5))
FAR = LidarConfig(max_range=4.0, far_range=12.0)


def valley() -> list[Mesh]:
    """Rough ground 2 m below, walls around, thin poles between."""
    rng = np.random.default_rng(0)
    poles = [box((x, y, 1.0), (0.1, 0.1, 9.0)) for x, y in ((4, -3), (6, 2), (9, -1), (-5, 4), (2, 7), (-7, -6))]
    walls = [box((11.5, 0, 1), (1, 24, 9)), box((0, 9, 1), (24, 1, 9)), box((0, -9.5, 1), (24, 1, 9))]
    return [terrain(rng).translated((0, 0, -2.0)), *poles, *walls]


@pytest.fixture(scope="module")
def lidar() -> Lidar:
    return Lidar(valley(), BODY, FAR)


class Vehicle:
    """Flies on and turns, rolls and pitches as it does."""

    velocity = np.array([1.5, 0.4, 0.1])

    def at(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Position and attitude."""
        return self.velocity * 0.1 * step, np.array([0.2 * math.sin(step), 0.2 * math.cos(2 * step), 0.15 * step])

    def scans(self, lidar: Lidar, bodies: Iterator[np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Cloud, position and attitude, one vehicle."""
        for step, body in enumerate(bodies):
            place, attitude = self.at(step)
            yield lidar.scan(place[None], body_to_world(attitude[None]), body), place, attitude

    def seen(
        self,
        lidar: Lidar,
        bodies: list[np.ndarray],
        sight: MotionSight | None = None,
        *,
        noisy: bool = False,
        wrong: tuple[float, float, float] = (0.0, 0.0, 0.0),  # degrees of roll, pitch and yaw, new at each scan
    ) -> np.ndarray:
        """What is reported after each scan, in world axes from where the vehicle began, ``[T, K, 7]``."""
        sight, found, rng = sight or MotionSight(1), [], np.random.default_rng(0)
        bias = np.radians([1.0, -1.0, 2.0]) * noisy  # of an autopilot's roll, pitch and yaw
        for cloud, place, attitude in self.scans(lidar, iter(bodies)):
            far = cloud.reshape(1, 1808, 16, 3)[:, ::5].reshape(1, -1, 3)
            velocity = self.velocity + rng.normal(0, 0.1, 3) * (noisy or any(wrong))
            said = attitude + bias + (np.radians(wrong) * rng.normal(0, 1, 3) if any(wrong) else 0.0)
            objects = sight.look(far, velocity[None], said[None])[0].astype(float)
            level = body_to_world(np.array([[0.0, 0.0, said[2]]]))[0]
            turn = body_to_world(attitude[None])[0] @ body_to_world(said[None])[0].T @ level
            if not any(wrong):
                turn = body_to_world(np.array([[0.0, 0.0, attitude[2]]]))[0]
            there = objects[:, 6:] > 0
            objects[:, :3] = there * (objects[:, :3] @ turn.T + place)
            objects[:, 3:6] = objects[:, 3:6] @ turn.T
            found.append(objects)
        return np.array(found)


def straight(start: tuple[float, float, float], speed: float, heading: float, steps: int) -> list[np.ndarray]:
    """Poses ``[1, 4]`` of a body that flies level."""
    way = np.array([math.cos(heading), math.sin(heading), 0.0]) * speed * 0.1
    return [np.array([[*(np.array(start) + way * step), heading]]) for step in range(steps)]


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


class ScanEnv(EnvBase):
    """Three level sensors at rest in free air, past each of which a ball flies at 3 m/s, from the first step on."""

    def __init__(self) -> None:
        super().__init__(batch_size=torch.Size([3]))
        ring = torch.linspace(-0.3, 0.3, 7)
        self.ball = torch.stack(torch.broadcast_tensors(torch.tensor(6.0), ring[:, None], ring), -1).reshape(-1, 3)
        self.age = torch.zeros(3)
        shapes = {"point_cloud": self.ball.shape, "velocity": (3,), "attitude": (3,)}
        self.observation_spec = Composite({key: Unbounded((3, *shape)) for key, shape in shapes.items()}, shape=(3,))
        self.action_spec = SmallEnv().action_spec
        self.reward_spec = Unbounded((3, 1))
        self.done_spec = SmallEnv().done_spec

    def _observe(self) -> TensorDict:
        moved = torch.zeros(3, 1, 3)
        moved[:, 0, 1] = 0.3 * self.age
        ends = {key: torch.zeros(3, 1, dtype=torch.bool) for key in ("done", "terminated")}
        rest = {"velocity": torch.zeros(3, 3), "attitude": torch.zeros(3, 3)}
        return TensorDict({"point_cloud": self.ball + moved, **rest, **ends}, [3])

    def _reset(self, tensordict: TensorDict | None = None, **_: object) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self.age = torch.where(torch.ones(3, dtype=torch.bool) if mask is None else mask.reshape(3), 0.0, self.age)
        return self._observe()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        self.age = self.age + 1
        return self._observe().set("reward", torch.zeros(3, 1))

    def _set_seed(self, seed: int | None) -> None:
        pass


class TestMovingObjects(TransformContract):
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

    def apply(self, transform: MovingObjects, data: TensorDict) -> torch.Tensor:
        """As an environment would."""
        return transform._call(data)["moving_objects"]

    def test_as_a_module_in_a_model(self) -> None:
        with pytest.raises(UavrlError, match="append it to an environment"):
            torch.nn.Sequential(self.make_transform())(self.make_data(4))

    def test_in_a_replay_buffer(self) -> None:
        buffer = ReplayBuffer(batch_size=4, transform=self.make_transform())
        with pytest.raises(UavrlError, match="follows scans through time"):
            buffer.extend(self.make_data(8))
            buffer.sample()

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
    assert _make_mirror(validate_run(compose(*chosen))).motion
    assert not _make_mirror(validate_run(compose("buffer.mirror=true"))).motion


def test_the_sensor_looks_as_far_as_objects_are_looked_for() -> None:
    assert validate_run(compose("perception.motion=12")).perception["lidar"].far_range == 12.0
    off = validate_run(compose()).perception
    assert off["motion"] is None and off["lidar"].far_range is None


@pytest.mark.parametrize("motion", [3, 12])
def test_a_sensor_that_reaches_as_far_without_it_will_do(motion: int) -> None:
    """With a LiDAR of 20 m no firing cycle need look farther, nor with sight that ends before the cells."""
    seen = validate_run(compose(f"perception.motion={motion}", "perception.lidar.max_range=20")).perception
    env = make_env(small_env(), seen, num_uavs=1)
    assert env.rollout(2)["observation"].shape == (1, 2, 3 * (35 + 21 + 73))
    env.close()


def test_looking_farther_than_the_sensor_reaches_is_refused() -> None:
    """What is not scanned would seem to be free, and all that comes into range to move."""
    seen = validate_run(compose("perception.motion=12", "perception.lidar.far_range=8")).perception
    with pytest.raises(UavrlError, match=r"perception\.motion=12 looks farther than the LiDAR, which reaches 8 m"):
        make_env(small_env(), seen)
