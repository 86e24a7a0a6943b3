"""The coarse range image: literal values, an oracle, and what TorchRL asks of a transform."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import TransformedEnv, check_env_specs

from tests.helpers.clouds import OfClouds
from tests.helpers.contracts import TransformContract
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.world import WorldConfig
from uavrl.transforms import REDUCTIONS, Mirror, NavigationState, RangeImage
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl.transforms.range_image import range_image, range_image_directions
from uavrl_onboard.lidar.vlp16 import LASER_ELEVATIONS
from uavrl_onboard.perception.cells import VLP16_GRID


def towards(azimuth_deg: float, elevation_deg: float, distance: float) -> list[float]:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    across = distance * math.cos(elevation)
    return [across * math.cos(azimuth), across * math.sin(azimuth), distance * math.sin(elevation)]


def oracle(points: np.ndarray, radius: float, statistic: str) -> np.ndarray:
    """Point by point, with angles in degrees."""
    least = [math.inf] * 72
    for x, y, z in points:
        distance = math.sqrt(x * x + y * y + z * z)
        if not 0.05 < distance < radius:
            continue
        azimuth, elevation = math.degrees(math.atan2(y, x)), math.degrees(math.asin(z / distance))
        column, row = math.floor((azimuth + 7.5) / 15) % 24, 0 if elevation < -4 else 1 if elevation < 4 else 2
        middle = towards(15 * column, 10 * (row - 1), radius)
        told = math.dist((x, y, z), middle) if statistic == "face" else distance
        least[3 * column + row] = min(least[3 * column + row], told, radius)
    nothing = math.inf if statistic == "proximity" else 0.0
    told_all = [nothing if math.isinf(value) else value for value in least]
    return np.array([max(radius - value, 0.0) if statistic == "proximity" else value for value in told_all])


@pytest.mark.parametrize(
    ("azimuth", "elevation", "cell"),
    [
        (0, 0, 1),
        (7, 0, 1),
        (8, 0, 4),
        (-8, 0, 70),
        (90, 10, 20),
        (180, -10, 36),
        (-90, 3, 55),
        (0, 5, 2),
        (0, -5, 0),
        (0, 80, 2),
    ],
)
def test_a_point_belongs_to_its_cell(azimuth: float, elevation: float, cell: int) -> None:
    image = range_image(torch.tensor([towards(azimuth, elevation, 1.5)]))
    assert image.nonzero().tolist() == [[cell]]
    assert image[cell].item() == pytest.approx(2.5)
    by_range = range_image(torch.tensor([towards(azimuth, elevation, 1.5)]), statistic="range")
    assert by_range[cell].item() == pytest.approx(1.5)


def test_rounding_moves_no_lasers_points_to_another_row() -> None:
    """Of a real recording, or of a scan that was written as packets, a point may be a hundredth of a degree off."""
    from_border = np.abs(np.array(LASER_ELEVATIONS)[:, None] - np.array(VLP16_GRID.row_borders))
    np.testing.assert_allclose(from_border.min(0), 1.0)
    assert [sum(laser < border for laser in LASER_ELEVATIONS) for border in (-4, 4)] == [6, 10]


def test_directions_are_the_cells_middles() -> None:
    directions = range_image_directions()
    assert range_image(directions[:, None]).argmax(-1).tolist() == list(range(72))
    torch.testing.assert_close(directions[3 * 6 + 2], torch.tensor(towards(90, 10, 1.0)))
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(72))


@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
@pytest.mark.parametrize("radius", [4.0, 2.5])
def test_it_agrees_with_the_oracle(statistic: str, radius: float) -> None:
    points = np.random.default_rng(0).normal(scale=(2.0, 2.0, 0.6), size=(4000, 3))
    got = range_image(torch.tensor(points), radius, statistic)  # type: ignore[arg-type]
    np.testing.assert_allclose(got, oracle(points, radius, statistic), atol=1e-9)


def test_batches_order_and_misses_change_nothing() -> None:
    clouds = torch.randn(2, 3, 500, 3, generator=torch.Generator().manual_seed(0)) * 2
    whole = range_image(clouds)
    assert whole.shape == (2, 3, 72)
    shuffled = clouds[..., torch.randperm(500), :]
    bad = torch.tensor([torch.nan, torch.inf, -torch.inf, 0.0, -0.0, 0.02])
    padded = torch.cat([shuffled, bad[:, None].expand(2, 3, 6, 3)], -2)
    assert range_image(padded).equal(whole)
    assert range_image(clouds[1, 2]).equal(whole[1, 2])
    assert range_image(torch.empty(2, 0, 3)).equal(torch.zeros(2, 72))
    assert (
        range_image(4 * (1 - 1e-5) * range_image_directions(), statistic="face").gt(0).all()
    )  # touching is not nothing


def test_the_ball_ends_at_its_radius_and_begins_outside_the_sensors_housing() -> None:
    """What a LiDAR whose range is cut to the radius does not report, a farther scan must not show either."""
    points = torch.tensor([0.05, 0.051, 4 * (1 - 1e-5), 4.0, 4.1])[:, None, None] * range_image_directions()
    for statistic, read in (("range", [0.0, 0.051, 3.99996, 0.0, 0.0]), ("proximity", [0.0, 3.949, 4e-5, 0.0, 0.0])):
        image = range_image(points[:, :, None], statistic=statistic).amax((-2, -1))  # type: ignore[arg-type]
        torch.testing.assert_close(image, torch.tensor(read), atol=2e-6, rtol=0.0)


@pytest.mark.parametrize("radius", [4.0, 2.5, 7.3])
def test_a_point_at_the_radius_is_a_miss_whatever_rounding_does(radius: float) -> None:
    directions = torch.nn.functional.normalize(torch.randn(5000, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    assert not range_image(directions * radius, radius, "range").any()
    assert range_image(directions * radius * (1 - 1e-5), radius, "range").all()


@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
@pytest.mark.parametrize("reduce", [range_image, truncated_icosahedron])
def test_whatever_a_driver_writes_for_a_miss_reads_as_nothing(reduce: Callable[..., Tensor], statistic: str) -> None:
    cloud = torch.randn(2, 400, 3, generator=torch.Generator().manual_seed(0)) * 2
    missed = torch.arange(400) % 3 > 0
    seen = reduce(cloud[:, ~missed], 4.0, statistic)
    assert seen.any()
    for miss in ([0.0, 0.0, 0.0], [-0.0, 0.0, -0.0], [torch.nan] * 3, [torch.inf, 0.0, 0.0], [0.02, -0.03, 0.03]):
        assert reduce(torch.where(missed[:, None], torch.tensor(miss), cloud), 4.0, statistic).equal(seen)
        assert not reduce(torch.tensor(miss).expand(1, 28928, 3), 4.0, statistic).any()


def test_a_mirror_shows_the_mirrored_scan_and_the_guides_action_as_the_policys() -> None:
    clouds = torch.randn(4, 300, 3, generator=torch.Generator().manual_seed(1)) * 2
    seen, mirrored = torch.zeros(2, 4, 75)
    for state, side in ((seen, 1.0), (mirrored, -1.0)):
        state[:, :72] = range_image(clouds * torch.tensor([1.0, side, 1.0])) / 4
        state[:, 72:] = torch.tensor([0.1, 0.2 * side, 0.3])
    actions = {"action": torch.ones(4, 4), "demonstrator_action": torch.full((4, 4), 0.5)}
    data = TensorDict({"observation": seen, **actions, "next": {"observation": mirrored}}, [4])
    image = Mirror(actions=["action", "demonstrator_action"], probability=1.0, reduction="range_image")(data)
    assert image["action"][0].tolist() == [1.0, -1.0, 1.0, -1.0]
    assert image["demonstrator_action"][0].tolist() == [0.5, -0.5, 0.5, -0.5]
    torch.testing.assert_close(image["observation"], mirrored)
    torch.testing.assert_close(image["next", "observation"], seen)


def test_the_state_of_a_flight() -> None:
    base = NavigationEnv(2, world=WorldConfig(size=(60.0, 60.0), obstacles=6), lidar=LidarConfig(max_range=4.0))
    env = TransformedEnv(base, NavigationState(reduction="range_image", statistic="proximity", last_action=True))
    check_env_specs(env)
    flown = env.rollout(3)
    assert flown["observation"].shape == (2, 3, 3 * (72 + 3 + 4))
    torch.testing.assert_close(flown["observation"][..., -79:-7], flown["faces"] / 4)
    assert [NavigationState(reduction=each)[0].statistic for each in REDUCTIONS] == ["face", "proximity"]
    with pytest.raises(ValueError, match="reduction must be one of truncated_icosahedron, range_image"):
        NavigationState(reduction="cube")  # type: ignore[arg-type]


class TestTransform(OfClouds, TransformContract):
    def make_transform(self) -> RangeImage:
        return RangeImage()
