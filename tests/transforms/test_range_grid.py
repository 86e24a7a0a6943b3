"""Range images of other sensors: their cells, their directions, and what follows from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv, check_env_specs

from tests.helpers.clouds import OfClouds
from tests.helpers.contracts import TransformContract
from tests.helpers.numpy_reductions import clouds
from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.sensors import SENSORS
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.policies.baselines import VectorFieldHistogram
from uavrl.transforms import Mirror, NavigationState, RangeImage, TruncatedIcosahedron
from uavrl.transforms.range_image import range_image, range_image_directions
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.pages.shapes import shell
from uavrl_onboard.perception import reductions as in_numpy
from uavrl_onboard.perception.cells import VLP16_GRID, RangeGrid, grid_directions

WIDE = RangeGrid(columns=36, rows=4, elevation=(-25.0, 15.0))
UNEVEN = RangeGrid(columns=10, rows=3, elevation=(-30.0, 30.0), borders=(5.0, 20.0))
FLAT = RangeGrid(columns=7, rows=1, elevation=(-1.0, 1.0))
GRIDS = [VLP16_GRID, WIDE, UNEVEN, FLAT]


def towards(azimuth_deg: float, elevation_deg: float, distance: float) -> list[float]:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    across = distance * math.cos(elevation)
    return [across * math.cos(azimuth), across * math.sin(azimuth), distance * math.sin(elevation)]


def test_the_default_grid_is_that_of_the_packaged_policies_bit_by_bit() -> None:
    """The formulas that the 72 cells had before there were others."""
    before = grid_directions(24, [(row - 1) * math.radians(10.0) for row in range(3)])
    assert range_image_directions(dtype=torch.float64).numpy().tobytes() == before.tobytes()
    assert [math.radians(each) for each in VLP16_GRID.row_borders] == [math.radians(-4.0), math.radians(4.0)]
    assert RangeImage(columns=24, rows=3, elevation=(-15, 15), borders=(-4, 4)).grid == VLP16_GRID
    assert RangeImage().directions is RangeImage.directions


@pytest.mark.parametrize(
    ("grid", "azimuth", "elevation", "cell"),
    [
        (WIDE, 0, -20, 0),
        (WIDE, 4, 14, 3),
        (WIDE, 6, -4, 6),
        (WIDE, -10, 80, 143),
        (WIDE, 90, -6, 37),
        (UNEVEN, 0, 4, 0),
        (UNEVEN, 0, 6, 1),
        (UNEVEN, 180, 25, 17),
        (FLAT, 180.1, 50, 4),
    ],
)
def test_a_point_belongs_to_its_cell(grid: RangeGrid, azimuth: float, elevation: float, cell: int) -> None:
    image = range_image(torch.tensor([towards(azimuth, elevation, 1.5)]), grid=grid)
    assert image.shape == (grid.count,) and image.nonzero().tolist() == [[cell]]


def test_middles_are_those_of_equal_rows_where_the_borders_allow_it() -> None:
    assert WIDE.row_borders == (-15.0, -5.0, 5.0) and WIDE.middles == (-20.0, -10.0, 0.0, 10.0)
    assert UNEVEN.middles == (-12.5, 12.5, 25.0)
    assert RangeGrid(rows=3, borders=(-4.5, 4.5)).middles == (-10.0, 0.0, 10.0)


@pytest.mark.parametrize("grid", GRIDS)
def test_directions_are_the_cells_middles(grid: RangeGrid) -> None:
    directions = RangeImage(**vars(grid)).directions()
    assert range_image(directions[:, None], grid=grid).argmax(-1).tolist() == list(range(grid.count))


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
def test_numpy_reduces_as_torch_does(grid: RangeGrid, statistic: str) -> None:
    drawn = clouds(100, 40)
    theirs = range_image(torch.from_numpy(drawn), 4.0, statistic, grid).numpy()  # type: ignore[arg-type]
    found = np.stack([in_numpy.range_image(cloud, 4.0, statistic, grid) for cloud in drawn])  # type: ignore[arg-type]
    np.testing.assert_allclose(found, theirs, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(
        in_numpy.directions("range_image", grid).astype(np.float32), range_image_directions(grid).numpy()
    )


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"columns": 90.5}, "whole numbers of columns and rows, got columns=90.5"),
        ({"elevation": 22.5}, "lowest and the highest elevation in degrees"),
        ({"columns": 0}, "at least one column and one row and at most 10,000 cells, got columns=0"),
        ({"columns": 3600, "rows": 10}, "at most 10,000 cells"),
        ({"elevation": (15, -15)}, "all ascending, got elevation"),
        ({"elevation": (-91, 15)}, r"in \[-90, 90\] degrees"),
        ({"borders": (0,)}, "2 borders between them"),
        ({"borders": (4, -4)}, "all ascending"),
        ({"borders": (-16, 4)}, "all ascending"),
    ],
)
def test_what_is_no_grid_is_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        RangeImage(**settings)  # type: ignore[arg-type]


# ---------------------------------------------------------------------- for a sensor


def lidar(elevations: list[float], azimuths: list[float]) -> torch.Tensor:
    return torch.tensor([towards(azimuth, elevation, 1.0) for azimuth in azimuths for elevation in elevations])


def test_a_vlp16_gets_the_default_grid() -> None:
    assert RangeImage.for_sensor(torch.from_numpy(firing_directions())).grid == VLP16_GRID


def test_a_grid_for_a_sensors_field_of_view() -> None:
    """No laser lies on a border, and the default statistic and other arguments stay."""
    made = RangeImage.for_sensor(lidar([*range(-25, 16, 5)], [*range(0, 360, 2)]), columns=36, rows=4, radius=8.0)
    assert (made.radius, made.statistic, made.grid.elevation) == (8.0, "proximity", (-25.0, 15.0))
    assert made.grid.row_borders == (-12.5, -7.5, 2.5)  # of -17.5 and -12.5 the one nearer to the middle
    many = np.random.default_rng(0).uniform(-7, 52, 5000).round(2).tolist()
    even = RangeImage.for_sensor(lidar([-7.0, 52.0, *many], [0.0]), rows=2).grid
    assert even.row_borders == (22.5,)


def test_a_sensor_of_one_layer_gets_one_row() -> None:
    made = RangeImage.for_sensor(torch.from_numpy(SENSORS["rplidar"].rays.directions[0].copy()), rows=1)
    assert made.grid.elevation == (-5.0, 5.0) and made.grid.count == 24
    assert made.unseen_cells(torch.from_numpy(SENSORS["rplidar"].rays.directions[0].copy())) == []


def test_what_is_no_sensor_for_a_grid_is_refused() -> None:
    with pytest.raises(UavrlError, match="Expected rays at 3 elevations or more for 3 rows, got 2"):
        RangeImage.for_sensor(lidar([-1.0, 1.0], [0.0]))
    with pytest.raises(UavrlError, match="has no rays in some of 4 equal rows"):
        RangeImage.for_sensor(lidar([-30.0, 0.0, 1.0, 2.0, 3.0, 4.0], [0.0]), rows=4)
    with pytest.raises(UavrlError, match="directions of a sensor's rays"):
        RangeImage.for_sensor(torch.zeros(3, 3))


def test_cells_that_a_sensor_cannot_see_are_listed() -> None:
    """A sensor of 120 degrees ahead and 5 degrees down to 20 up: by its azimuths, and by its elevations."""
    rays = lidar([-5.0, 0.0, 5.0, 10.0, 15.0, 20.0], [float(azimuth) for azimuth in range(-60, 61)])
    unseen = RangeImage(columns=12, rows=3, elevation=(-30, 30)).unseen_cells(rays)
    ahead = [column for column in range(12) if min(column, 12 - column) <= 2]  # 0, ±30, ±60
    seen = {3 * column + row for column in ahead for row in (1, 2)}
    assert unseen == sorted({*range(36)} - seen)
    assert RangeImage().unseen_cells(torch.from_numpy(firing_directions())) == []
    below_or_above = {0, 1, 10, 11, 12, 13, 30, 31}
    assert set(TruncatedIcosahedron().unseen_cells(torch.from_numpy(firing_directions()))) == below_or_above


# ---------------------------------------------------------------------- what follows from the directions


@pytest.mark.parametrize("grid", [WIDE, UNEVEN])
def test_a_mirror_shows_the_mirrored_scan(grid: RangeGrid) -> None:
    drawn = torch.randn(4, 300, 3, generator=torch.Generator().manual_seed(1)) * 2
    seen, mirrored = torch.zeros(2, 4, grid.count + 3)
    for state, side in ((seen, 1.0), (mirrored, -1.0)):
        state[:, : grid.count] = range_image(drawn * torch.tensor([1.0, side, 1.0]), grid=grid) / 4
        state[:, grid.count :] = torch.tensor([0.1, 0.2 * side, 0.3])
    data = TensorDict({"observation": seen, "action": torch.ones(4, 4), "next": {"observation": mirrored}}, [4])
    image = Mirror(probability=1.0, reduction="range_image", grid=grid)(data)
    torch.testing.assert_close(image["observation"], mirrored)
    torch.testing.assert_close(image["next", "observation"], seen)
    with pytest.raises(ValueError, match=rf"Expected observations \[\*B, F \* {grid.count + 3}\]"):
        Mirror(probability=1.0, reduction="range_image", grid=grid)(data.set("observation", torch.zeros(4, 75)))


@pytest.mark.parametrize("grid", GRIDS)
def test_vfh_flies_to_the_goal_where_all_is_full_or_empty_and_round_a_wall_ahead(grid: RangeGrid) -> None:
    """And weighs a scan that is full everywhere as much as with the default grid."""
    rule, default = (
        VectorFieldHistogram(reduction="range_image", grid=grid),
        VectorFieldHistogram(reduction="range_image"),
    )
    torch.testing.assert_close(rule._seen_in.sum(-1), default._seen_in.sum(-1))
    told = {"heading_deg": torch.zeros(1, 1), "altitude": torch.full((1, 1), 3.5)}
    free = rule(TensorDict({"faces": torch.zeros(1, grid.count), **told}, [1]))["action"]
    assert free[0, 0] > 1.9
    ahead = (RangeImage(**vars(grid)).directions()[:, 0] > 0.8) * 3.5
    blocked = rule(TensorDict({"faces": ahead[None], **told}, [1]))["action"]
    assert blocked[0, 0] < free[0, 0] - 0.5


def test_vfh_with_the_default_grid_is_what_it_was() -> None:
    one = VectorFieldHistogram(reduction="range_image", grid=VLP16_GRID)
    assert torch.equal(one._seen_in, VectorFieldHistogram(reduction="range_image")._seen_in)


def test_another_grid_is_drawn_by_its_directions() -> None:
    drawn = shell(RangeImage(**vars(WIDE)).directions().numpy(), 4.0)
    assert set(drawn.faces.tolist()) == set(range(WIDE.count))


def test_the_state_of_a_flight() -> None:
    base = NavigationEnv(2, world=WorldConfig(size=(60.0, 60.0), obstacles=6), lidar=LidarConfig(max_range=4.0))
    env = TransformedEnv(base, NavigationState(reduction="range_image", grid=WIDE, last_action=True))
    check_env_specs(env)
    flown = env.rollout(3)
    assert flown["observation"].shape == (2, 3, 3 * (144 + 3 + 4))
    with pytest.raises(UavrlError, match="grid is that of reduction=range_image, and this is truncated_icosahedron"):
        NavigationState(grid=WIDE)
    NavigationState(grid=VLP16_GRID)  # as the configuration has it


class TestTransform(OfClouds, TransformContract):
    def make_transform(self) -> RangeImage:
        return RangeImage(columns=36, rows=4, elevation=(-25, 15))
