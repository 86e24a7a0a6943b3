"""How near moving objects would come on each way, against a fine simulation, and turned and mirrored."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase, TransformedEnv

from tests.helpers.contracts import TransformContract
from tests.helpers.moving import ScanEnv
from uavrl.transforms import MovingObjects, mirror_observation
from uavrl.transforms.threats import DIRECTIONS, Threats
from uavrl_onboard.perception.motion.threats import GREATEST, HIGH, LAG, WIDE

AHEAD, LEFT, BEHIND, STANDING = 1, 19, 37, 72
MET = 1 / GREATEST  # what a way has at least on which an object is met


def threats(*objects: tuple[float, ...], velocity: tuple[float, ...] = (0, 0, 0), yaw: float = 0.0) -> torch.Tensor:
    """Of each direction and of standing, ``[73]``."""
    return Threats()(state(*objects, velocity=velocity, yaw=yaw))["threats"][0]


def state(*objects: tuple[float, ...], velocity: tuple[float, ...], yaw: float) -> TensorDict:
    told = torch.tensor([list(objects) + [(0.0,) * 7] * (3 - len(objects))]).reshape(1, 21)
    attitude = torch.tensor([[0.1, -0.1, yaw]])
    return TensorDict(moving_objects=told, velocity=torch.tensor([velocity]).float(), attitude=attitude, batch_size=[1])


def test_directions_are_named_rightly() -> None:
    expected = torch.tensor([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0]])
    torch.testing.assert_close(DIRECTIONS[[AHEAD, LEFT, BEHIND]], expected, atol=1e-6, rtol=0)


def test_where_nothing_moves_nothing_threatens() -> None:
    assert threats().abs().max() == 0.0


def test_what_crosses_ahead_threatens_the_way_that_it_meets_alone() -> None:
    found = threats((3.0, 4.5, 0.0, 0.0, -3.0, 0.0, 1.0), velocity=(2.0, 0.0, 0.0))  # both at (3, 0) after 1.5 s
    assert found[AHEAD] > MET
    assert found[[BEHIND, STANDING]].max() == 0.0


def test_it_is_told_in_the_axes_of_the_yaw_that_the_velocity_is_turned_to() -> None:
    crossing = (3.0, 4.5, 0.0, 0.0, -3.0, 0.0, 1.0)
    ahead = threats(crossing, velocity=(2.0, 0.0, 0.0))
    turned = threats(crossing, velocity=(0.0, 2.0, 0.0), yaw=torch.pi / 2)
    torch.testing.assert_close(ahead, turned)
    assert not torch.allclose(ahead, threats(crossing, velocity=(0.0, 2.0, 0.0)))


def fly(commanded: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Where a vehicle comes that is told ``commanded [D, 3]``, in steps of a millisecond: ``[20, D, 3]``."""
    position, speed, places = np.zeros_like(commanded), np.tile(velocity, (len(commanded), 1)), []
    for step in range(1, 2001):
        speed += 0.001 / LAG * (commanded - speed)
        position += 0.001 * speed
        if step % 100 == 0:
            places.append(position.copy())
    return np.array(places)


@pytest.mark.parametrize("seed", range(8))
def test_a_way_is_threatened_exactly_where_a_fine_simulation_comes_too_near(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocity, flies = rng.uniform(-2, 2, 3), rng.uniform([-4, -4, -0.5], [4, 4, 0.5])
    paths = fly(np.concatenate([2 * DIRECTIONS.numpy(), np.zeros((1, 3))]), velocity)
    place = paths[15, rng.integers(73)] - 1.6 * flies  # so that one of the ways meets it after 1.6 s
    found = threats((*place, *flies, 1.0), velocity=tuple(velocity)).numpy()
    x, y, z = np.moveaxis(paths - place - flies * (np.arange(1, 21) * 0.1)[:, None, None], -1, 0)
    least = np.maximum(np.hypot(x, y) / WIDE, np.abs(z) / HIGH).min(0)
    sure = np.abs(least - 1) > 0.01  # not on the border
    assert ((found > MET) == (least < 1))[sure].all()
    assert (found[least > 1.25] == 0).all()
    assert 0 < (least < 1).sum() < 73


@pytest.mark.parametrize("batch", [(), (0,), (2, 3)])
def test_any_batch_has_threats(batch: tuple[int, ...]) -> None:
    told = {"moving_objects": 21, "velocity": 3, "attitude": 3}
    data = TensorDict({key: torch.zeros(*batch, width) for key, width in told.items()}, batch)
    assert Threats()(data)["threats"].shape == (*batch, 73)


def test_other_numbers_of_keys_are_refused() -> None:
    with pytest.raises(ValueError, match="three in_keys"):
        Threats(in_keys=["moving_objects"])


def test_the_mirrored_object_threatens_the_mirrored_ways() -> None:
    image = threats((3.0, 4.5, 0.4, 0.0, -3.0, 0.0, 1.0), velocity=(1.0, -0.5, 0.2))
    mirrored = threats((3.0, -4.5, 0.4, 0.0, 3.0, 0.0, 1.0), velocity=(1.0, 0.5, 0.2))
    observation = torch.cat([torch.zeros(72 + 3 + 21), image])
    expected = torch.cat([torch.zeros(72 + 3 + 21), mirrored])
    torch.testing.assert_close(
        mirror_observation(observation, motion=True, reduction="range_image"), expected, atol=1e-6, rtol=0
    )


class TestThreats(TransformContract):
    def make_transform(self) -> Threats:
        return Threats()

    @staticmethod
    def make_env() -> EnvBase:
        return TransformedEnv(ScanEnv(), MovingObjects())

    def make_data(self, *batch: int) -> TensorDict:
        random = torch.Generator().manual_seed(0)
        told = {key: torch.randn(*batch, 3, generator=random) for key in ("velocity", "attitude")}
        return TensorDict({"moving_objects": 2 * torch.randn(*batch, 21, generator=random), **told}, batch)
