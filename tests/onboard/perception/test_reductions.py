"""The reductions in numpy against those in PyTorch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.helpers.numpy_reductions import MISSES, PAIRS, check_clouds, clouds
from uavrl.transforms import REDUCTIONS
from uavrl.transforms.reduction import is_return as torch_is_return
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN, is_return, within
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.perception.reductions import directions, range_image
from uavrl_onboard.perception.view import View


@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
@pytest.mark.parametrize(("ours", "name"), PAIRS)
def test_clouds_reduce_as_in_torch(ours: Any, name: Any, statistic: str) -> None:
    check_clouds(ours, name, statistic, 500)


@pytest.mark.parametrize(("ours", "name"), PAIRS)
def test_a_whole_scan_and_other_radii_reduce_as_in_torch(ours: Any, name: Any) -> None:
    rng = np.random.default_rng(1)
    scan = firing_directions() * rng.uniform(0.5, 12, (28928, 1)).astype(np.float32)
    level = np.abs(np.degrees(np.arcsin(firing_directions()[:, 2]))).round(3)
    scan = scan[level != 5.0]  # these lie on the border of two cells, where float32 decides
    for radius, dtype in ((0.5, np.float32), (4.0, np.float64), (10.0, np.float64)):
        cloud = scan.astype(dtype)
        theirs = REDUCTIONS[name].reduced(torch.from_numpy(cloud), radius, "range").numpy()
        np.testing.assert_allclose(ours(cloud, radius, "range"), theirs, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "view", [(-180.0, 180.0, -7.0, 52.0), (-43.5, 43.5, -29.0, 29.0), (-177.0, 178.0, -15.0, 15.0)]
)
@pytest.mark.parametrize(("ours", "name"), PAIRS)
def test_what_another_sensor_sees_besides_is_in_no_cell(ours: Any, name: Any, view: View) -> None:
    drawn = clouds(200, 20, seed=2)
    x, y, z = drawn.astype(float).transpose(2, 0, 1)
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    right, left, low, high = (angle + slack for angle, slack in zip(view, (-0.5, 0.5, -0.5, 0.5), strict=True))
    seen = (azimuth > right) & (azimuth < left) & (elevation > low) & (elevation < high)
    wanted = np.where(seen[..., None], drawn, np.nan).astype(np.float32)
    reduction = REDUCTIONS[name]()
    reduction.view = view
    found = reduction(TensorDict(point_cloud=torch.from_numpy(drawn)))["faces"].numpy()
    np.testing.assert_array_equal(found, REDUCTIONS[name].reduced(torch.from_numpy(wanted), 4.0, reduction.statistic))
    onboard = np.stack([ours(cloud, 4.0, reduction.statistic, view=view) for cloud in drawn])
    np.testing.assert_allclose(onboard, found, rtol=0, atol=1e-6)
    assert (found != reduction.reduced(torch.from_numpy(drawn), 4.0, reduction.statistic).numpy()).any()


def test_the_cells_lie_where_those_in_torch_lie() -> None:
    for _, name in PAIRS:
        np.testing.assert_array_equal(directions(name).astype(np.float32), REDUCTIONS[name].directions().numpy())


@pytest.mark.parametrize("miss", MISSES, ids=str)
def test_a_miss_is_a_miss_however_a_driver_writes_it(miss: list[float]) -> None:
    scan = np.tile(np.array(miss, np.float32), (28928, 1))
    assert not is_return(scan, within(4.0)).any() and not torch_is_return(torch.from_numpy(scan), 4.0).any()
    for ours, name in PAIRS:
        for statistic in ("face", "range", "proximity"):
            assert not ours(scan, 4.0, statistic).any()
            assert not REDUCTIONS[name].reduced(torch.from_numpy(scan), 4.0, statistic).any()


def test_what_touches_the_housing_is_a_return_and_what_is_in_it_is_none() -> None:
    near = np.array([[NEAREST_RETURN * 1.01, 0, 0], [NEAREST_RETURN * 0.99, 0, 0]], np.float32)
    assert is_return(near).tolist() == [True, False]
    assert range_image(near[:1])[1] == pytest.approx(4.0 - NEAREST_RETURN * 1.01)


def test_an_empty_cloud_is_empty_space() -> None:
    for ours, _ in PAIRS:
        assert not ours(np.empty((0, 3), np.float32)).any()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((np.zeros((3, 2)),), r"an array of floats \[P, 3\], got float64 \[3, 2\]"),
        ((np.zeros((3, 3), int),), "got int64"),
        (([[1.0, 2.0, 3.0]],), "got list"),
        ((np.zeros((3, 3)), 0.0), "radius must be"),
        ((np.zeros((3, 3)), np.nan), "radius must be"),
        ((np.zeros((3, 3)), 4.0, "mean"), "statistic must be one of face, range, proximity"),
    ],
)
def test_what_is_no_cloud_is_refused(arguments: tuple[Any, ...], said: str) -> None:
    for ours, _ in PAIRS:
        with pytest.raises(UavrlError, match=said):
            ours(*arguments)
