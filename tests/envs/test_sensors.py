"""The simulated LiDARs: their rays, what they see, and files of one's own."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib.format import write_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tests.helpers.folders import ROOT
from tests.helpers.scenes import box, clutter, poses
from uavrl.envs import Lidar, LidarConfig, LidarSensor, NavigationEnv
from uavrl.envs.sensors import SENSORS, lidar_sensor, sensor_of_view
from uavrl.envs.vehicle_params import VehicleParams
from uavrl.errors import UavrlError
from uavrl_onboard.perception.motion.rays import far_ray_indices

# rays; right, left, lowest and highest direction in degrees; from the data sheets
FIELDS = {
    "vlp16": (28_928, (-180.0, 180.0, -15.0, 15.0)),
    "os0_32": (32_768, (-180.0, 180.0, -45.0, 45.0)),
    "os0_128": (131_072, (-180.0, 180.0, -45.0, 45.0)),
    "os1_64": (65_536, (-180.0, 180.0, -21.2, 21.2)),
    "xt32": (64_000, (-180.0, 180.0, -16.0, 15.0)),
    "mid360": (20_000, (-180.0, 180.0, -7.0, 52.0)),
    "rplidar": (3_200, (-180.0, 180.0, 0.0, 0.0)),
    "d435": (6_360, (-43.5, 43.5, -29.0, 29.0)),
}


def test_every_sensor_has_the_field_of_view_of_its_data_sheet() -> None:
    assert set(SENSORS) == set(FIELDS)
    for name, (rays, view) in FIELDS.items():
        sensor = lidar_sensor(name)
        assert (sensor.num_rays, sensor.field_of_view) == (rays, view), name
        np.testing.assert_allclose(np.linalg.norm(sensor.rays.directions, axis=-1), 1, atol=1e-6)
        assert sensor.rays.times.shape == (rays,)
        assert 0 <= sensor.rays.times.min() <= sensor.rays.times.max() < 1 / sensor.rate


@pytest.mark.parametrize("name", SENSORS)
def test_culling_changes_no_point_of_any_sensor(name: str) -> None:
    config = LidarConfig(max_range=4.0, sensor=name, range_noise=0.0)
    culled, whole = (Lidar(clutter(1), None, config) for _ in range(2))
    whole._culler = None
    positions, rotations = poses(2, 3)
    found = culled.scan(positions, rotations, numbers=[0, 1, 39])
    np.testing.assert_array_equal(found, whole.scan(positions, rotations, numbers=[0, 1, 39]))
    assert not np.isnan(found[..., 0]).all()


@pytest.mark.parametrize("name", ["vlp16", "os0_32", "mid360", "d435"])
@pytest.mark.parametrize("mount", [(180.0, 0.0, 0.0), (0.0, 25.0, 0.0), (10.0, -70.0, 130.0)])
def test_a_mounted_sensor_sees_what_the_sensor_itself_sees_from_there(name: str, mount: tuple[float, ...]) -> None:
    upright = LidarConfig(max_range=4.0, sensor=name, range_noise=0.0, far_range=8.0)
    mounted = replace(upright, sensor={"like": name, "mount": list(mount)})
    positions, rotations = poses(2, 3)
    numbers, turn = [0, 1, 39], Rotation.from_euler("xyz", mount, degrees=True)
    of_sensor = Lidar(clutter(1), None, upright)
    of_sensor._reach = Lidar(clutter(1), None, mounted)._reach  # another ray of each direction reaches farther
    of_sensor._culler = None
    seen = of_sensor.scan(positions, rotations @ turn.as_matrix(), numbers=numbers)
    found = Lidar(clutter(1), None, mounted).scan(positions, rotations, numbers=numbers)
    expected = turn.apply(seen.reshape(-1, 3)).reshape(seen.shape)
    both = np.isfinite(found[..., 0]) & np.isfinite(seen[..., 0])
    assert both.sum() > 100
    assert (np.isfinite(found[..., 0]) != np.isfinite(seen[..., 0])).mean() < 1e-4  # rays that pass an edge
    error = np.linalg.norm(found[both] - expected[both], axis=-1)
    assert np.median(error) < 1e-5 and np.quantile(error, 0.999) < 1e-2


def test_a_sensor_like_one_of_ours_has_all_that_is_not_given(tmp_path: Path) -> None:
    (tmp_path / "hung.yaml").write_text("like: mid360\nmount: [180, 0, 0]\n")
    hung = lidar_sensor(str(tmp_path / "hung.yaml"))
    assert (hung.name, hung.num_rays, hung.repeats) == ("hung", 20_000, False)
    assert hung.field_of_view == (-180.0, 180.0, -52.0, 7.0)
    assert (hung.range_noise, hung.blind_distance) == (0.02, 0.1)
    fine = lidar_sensor({"like": "os0_32", "azimuth_steps": 2048, "range_noise": 0.0})
    assert (fine.num_rays, fine.range_noise, fine.max_range) == (65_536, 0.0, 50.0)
    sparse = lidar_sensor({"like": "vlp16", "mount": [0, 0, 90], "stride": 4})
    assert sparse.repeats and sparse.num_rays == 28_928 // 4


def test_a_scan_of_the_mid360_looks_between_the_rays_of_the_scan_before() -> None:
    rays = lidar_sensor("mid360").rays.directions.astype(float)

    nearest = np.degrees(cKDTree(rays[0]).query(rays[1])[0])
    assert np.median(nearest) > 0.15  # degrees; of a repeating pattern 0
    below = np.degrees(np.arcsin(rays[:10, :, 2])) < 0
    assert 0.15 < below.mean() < 0.25  # 7 of 59 degrees, where its sweep turns around
    columns = np.degrees(np.arctan2(rays[0, :, 1], rays[0, :, 0])) // 15
    assert np.unique(columns).size == 24  # each scan looks all around
    wall = [box((3.0, 0.0, 0.0), (0.2, 8.0, 8.0))]
    first, second, again = Lidar(wall, None, LidarConfig(sensor="mid360", range_noise=0.0)).scan(
        np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1)), numbers=[0, 1, 40]
    )
    np.testing.assert_array_equal(first, again)  # 40 scans, then from the beginning
    assert not np.array_equal(first, second, equal_nan=True)
    hits = second[~np.isnan(second[:, 0])]
    np.testing.assert_allclose(hits[np.abs(hits[:, 0] - 2.9) < 0.5][:, 0], 2.9, atol=1e-4)


def test_the_rays_of_the_mid360_lie_as_those_of_a_real_one() -> None:
    """A hundredth of a second of a real scan (`tests/data/livox`), at the moment of the pattern that fits it best."""
    layout = np.dtype({"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 26})
    raw = np.fromfile(ROOT / "tests" / "data" / "livox" / "kompass_2000_points.bin", layout)
    real = np.stack([raw[axis] for axis in "xyz"], -1).astype(float)
    hit = np.flatnonzero(real.any(-1))
    elevation = np.degrees(np.arctan2(real[hit, 2], np.hypot(real[hit, 0], real[hit, 1])))
    azimuth = np.arctan2(real[hit, 1], real[hit, 0])
    rays = lidar_sensor("mid360").rays.directions.astype(float).reshape(-1, 3)
    starts = range(0, 400_000, 4 * 25)  # the same beam first
    off = [np.abs(np.degrees(np.arcsin(rays[hit + start, 2])) - elevation).mean() for start in starts]
    best = starts[int(np.argmin(off))]
    assert min(off) < 1.5 and np.median(off) > 10.0  # degrees
    turned = np.exp(1j * (azimuth - np.arctan2(rays[hit + best, 1], rays[hit + best, 0])))
    assert abs(turned.mean()) > 0.98  # it turns as fast, and the same way


@pytest.mark.parametrize("name", ["vlp16", "os0_32", "mid360"])
def test_with_a_stride_the_rays_of_a_scan_are_spread_over_the_next_scans(name: str) -> None:
    whole, stride = SENSORS[name], 4
    sparse = replace(whole, stride=stride)
    walls, (positions, rotations) = clutter(1), poses(2, 1)

    def scan(sensor: LidarSensor, number: int) -> np.ndarray:
        lidar = Lidar(walls, None, {"sensor": sensor, "max_range": 4.0, "range_noise": 0.0})
        return lidar.scan(positions, rotations, numbers=[number])[0]

    at_once = scan(whole, 0).reshape(whole.rays.azimuths.shape[1], -1, 3)  # [azimuth steps, beams, 3]
    for number in range(stride):
        np.testing.assert_array_equal(scan(sparse, number), at_once[number::stride].reshape(-1, 3))
    assert sparse.num_rays * stride == whole.num_rays
    assert len(sparse.rays.directions) == stride * len(whole.rays.directions)
    assert sparse.rays.times.shape == (sparse.num_rays,)


def test_with_a_stride_a_scan_of_the_mid360_keeps_its_four_beams() -> None:
    whole = SENSORS["mid360"].rays.directions[0].reshape(-1, 4, 3)
    sparse = replace(SENSORS["mid360"], stride=4).rays.directions
    np.testing.assert_array_equal(sparse[0], whole[::4].reshape(-1, 3))
    np.testing.assert_array_equal(sparse[1], whole[1::4].reshape(-1, 3))


def test_a_ray_that_is_steep_has_no_azimuth() -> None:
    for mount in ((0.0, 90.0, 0.0), (90.0, 0.0, 0.0)):
        right, left, low, high = replace(SENSORS["rplidar"], mount=mount).field_of_view
        assert (low, high) == (-90.0, 90.0) and left - right in (180.0, 360.0)
    for view in ((0.0, 0.0, -10.0, 10.0), (30.0, 30.0, 0.0, 0.0)):
        assert sensor_of_view("line", view).field_of_view == pytest.approx(view, abs=0.11)


@pytest.mark.parametrize("stride", [2, 4, 5])
def test_with_a_stride_each_scan_has_a_far_ray_in_every_direction(stride: int) -> None:
    for directions in replace(SENSORS["vlp16"], stride=stride).rays.directions:
        far = directions[far_ray_indices(directions)]
        azimuth = np.degrees(np.arctan2(far[:, 1], far[:, 0]))
        assert np.diff(np.sort(azimuth)).max() < 2.1  # degrees


def test_a_blind_sector_hides_the_same_directions_with_a_stride() -> None:
    wall = [box((0.0, 0.0, 0.0), (3.0, 3.0, 3.0))]  # all around
    blind = VehicleParams(blind_sector=1.0, blind_azimuth=0.5)
    here, upright = np.zeros((1, 3)), np.eye(3)[None]
    whole = Lidar(wall, None, {"max_range": 4.0}).scan(here, upright, flaws=[blind])[0].reshape(1808, 16, 3)
    sparse = Lidar(wall, None, {"max_range": 4.0, "sensor": replace(SENSORS["vlp16"], stride=4)})
    seen = sparse.scan(here, upright, flaws=[blind], numbers=[3])[0].reshape(452, 16, 3)
    np.testing.assert_array_equal(seen, whole[3::4])
    assert 0.1 < np.isnan(seen[..., 0]).mean() < 0.25


def test_a_stride_that_divides_no_scan_evenly_leaves_the_last_steps_out() -> None:
    sparse = LidarSensor("mine", elevations=(0.0, 5.0), azimuth_steps=10, stride=3)
    azimuths = np.degrees(sparse.rays.azimuths).round()
    assert azimuths.tolist() == [[0, 108, 216], [36, 144, 252], [72, 180, 288]]
    with pytest.raises(UavrlError, match="stride must be a whole number from 1 to 50; got 0"):
        LidarSensor("mine", elevations=(0.0,), azimuth_steps=10, stride=0)
    with pytest.raises(UavrlError, match="has 10 azimuth steps, fewer than its stride of 11: lower stride"):
        LidarSensor("mine", elevations=(0.0,), azimuth_steps=10, stride=11)


def test_an_environment_shows_another_scan_of_a_changing_pattern_each_step() -> None:
    env = NavigationEnv(2, lidar={"sensor": "mid360", "max_range": 6.0, "range_noise": 0.0}, seed=1)
    state = env.reset()
    assert state["point_cloud"].shape == env.observation_spec["point_cloud"].shape == (2, 20_000, 3)
    pattern = lidar_sensor("mid360").rays.directions
    for step in range(3):
        for vehicle, task in enumerate(state["task"][:, 0].tolist()):
            points = state["point_cloud"][vehicle].numpy()
            hit = np.flatnonzero(~np.isnan(points[:, 0]))
            towards = points[hit] / np.linalg.norm(points[hit], axis=-1, keepdims=True)
            np.testing.assert_allclose(towards, pattern[task + step][hit], atol=1e-4)
        state["action"] = env.action_spec.zero()
        state = env.step(state)["next"]
    env.close()


def test_a_sensor_sees_as_far_as_it_does_and_nothing_nearer_than_its_blind_distance() -> None:
    walls = [box((9.5, 0.0, 0.0), (0.1, 1.0, 1.0)), box((0.0, 0.2, 0.0), (2.0, 0.02, 0.2))]
    level = (np.zeros((1, 3)), np.eye(3)[None])
    sensor = LidarSensor("mine", (0.0,), 360, max_range=8.0, blind_distance=0.5)
    seen = Lidar(walls, None, LidarConfig(sensor=sensor)).scan(*level)[0]
    distances = np.linalg.norm(seen[~np.isnan(seen[:, 0])], axis=-1)
    assert len(distances) and distances.min() >= 0.5 and distances.max() < 8.0
    near = Lidar(walls, None, LidarConfig(sensor=sensor, min_range=0.0)).scan(*level)[0]
    assert np.nanmin(np.linalg.norm(near, axis=-1)) == pytest.approx(0.19, abs=1e-4)
    with pytest.raises(UavrlError, match=r"'mine' sees nothing nearer than 0.5 m, and max_range is 0.4 m"):
        LidarConfig(sensor=sensor, max_range=0.4)


def test_range_noise_is_the_sensors_own_unless_it_is_given() -> None:
    wall = [box((3.0, 0.0, 0.0), (0.02, 40.0, 40.0))]
    level = (np.zeros((1, 3)), np.eye(3)[None])
    for config, spread in ((LidarConfig(sensor="mid360"), 0.02), (LidarConfig(sensor="mid360", range_noise=0.1), 0.1)):
        seen = Lidar(wall, None, config).scan(*level, rng=np.random.default_rng(0))[0]
        true = Lidar(wall, None, LidarConfig(sensor="mid360", range_noise=0.0)).scan(*level)[0]
        errors = np.linalg.norm(seen, axis=-1) - np.linalg.norm(true, axis=-1)
        assert np.nanstd(errors.astype(float)) == pytest.approx(spread, rel=0.05)
    assert LidarConfig().noise == LidarConfig().nearest == 0.0  # the thesis's sensor is ideal


def test_only_the_rays_that_look_for_motion_reach_farther() -> None:
    for name in ("os1_64", "mid360", "d435"):
        config = LidarConfig(max_range=4.0, far_range=8.0, sensor=name, range_noise=0.0)
        lidar = Lidar([box((6.0, 0.0, 0.0), (0.1, 30.0, 30.0))], None, config)
        seen = lidar.scan(np.zeros((1, 3)), np.eye(3)[None])[0]
        far = np.flatnonzero(~np.isnan(seen[:, 0]))
        searched = far_ray_indices(lidar.directions) if lidar.sensor.repeats else np.arange(lidar.sensor.num_rays)
        assert set(far) <= set(searched) and len(far) > 50
        everything = Lidar(lidar._meshes, None, LidarConfig(max_range=8.0, sensor=name, range_noise=0.0))
        whole = everything.scan(np.zeros((1, 3)), np.eye(3)[None])[0]
        np.testing.assert_array_equal(seen[far], whole[far])


def test_the_pixels_of_a_camera_are_exposed_at_once() -> None:
    wall = [box((3.0, 0.0, 0.0), (0.2, 20.0, 20.0))]
    config = LidarConfig(sensor="d435", motion_distortion=True, range_noise=0.0)
    told = {"velocities": np.array([[2.0, 0, 0]]), "angular_velocities": np.array([[0, 0, 2.0]])}
    seen = Lidar(wall, None, config).scan(np.zeros((1, 3)), np.eye(3)[None], **told)[0]
    np.testing.assert_allclose(seen[:, 0], 2.9, atol=1e-5)


def test_own_sensors_come_from_yaml_and_files_of_directions(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "elevations: [-10, 0, 10]\nazimuth_steps: 90\nazimuth: [-45, 45]\nmax_range: 20\n"
    )
    mine = lidar_sensor(str(tmp_path / "mine.yaml"))
    assert (mine.name, mine.num_rays, mine.max_range) == ("mine", 270, 20)
    assert mine.field_of_view == (-45.0, 45.0, -10.0, 10.0)
    np.savetxt(tmp_path / "rays.csv", [[0.0, 10.0], [90.0, -10.0]], delimiter=",")
    (tmp_path / "two.yaml").write_text("directions: rays.csv\n")
    two = lidar_sensor(str(tmp_path / "two.yaml"))
    np.testing.assert_allclose(two.rays.directions[0], [[0.9848, 0, 0.1736], [0, 0.9848, -0.1736]], atol=1e-4)
    pattern = np.array([[[2.0, 0, 0], [0, 3.0, 0]], [[0, 0, -1.0], [1.0, 0, 0]]])
    np.save(tmp_path / "scans.npy", pattern)
    three = lidar_sensor({"directions": str(tmp_path / "scans.npy"), "rate": 20})
    assert three.rays.directions.tolist() == [[[1, 0, 0], [0, 1, 0]], [[0, 0, -1], [1, 0, 0]]]
    seen = Lidar([], None, LidarConfig(sensor=three)).scan(np.zeros((1, 3)), np.eye(3)[None], numbers=[1])
    assert seen.shape == (1, 2, 3)


def test_files_as_other_programs_write_them(tmp_path: Path) -> None:
    (tmp_path / "EXCEL.CSV").write_text("\ufeff0,10\n90,-10\n", encoding="utf-8")
    (tmp_path / "MINE.YAML").write_text("directions: EXCEL.CSV\nname:\n")
    mine = lidar_sensor(str(tmp_path / "MINE.YAML"))
    assert (mine.name, mine.num_rays) == ("MINE", 2)
    far = lidar_sensor({"directions": _npy(tmp_path / "far.npy", [[1e200, 0.0, 0.0], [0.0, -3e-5, 0.0]])})
    assert far.rays.directions.tolist() == [[[1, 0, 0], [0, -1, 0]]]


@pytest.mark.parametrize("key", ["rate", "max_range", "blind_distance", "range_noise"])
def test_a_list_where_a_number_belongs_is_refused(key: str) -> None:
    with pytest.raises(UavrlError, match=rf"{key} must be a finite number, got \(30,\)\."):
        lidar_sensor({"elevations": [0.0], "azimuth_steps": 10, key: [30]})
    with pytest.raises(UavrlError, match=r"elevations must be finite numbers, got 5\.0\."):
        LidarSensor("mine", elevations=5.0, azimuth_steps=10)  # type: ignore[arg-type]
    with pytest.raises(UavrlError, match=r"max_range must be a finite number, got \[4\]\."):
        LidarConfig(max_range=[4])  # type: ignore[arg-type]


def _npy(path: Path, values: object) -> str:
    with path.open("wb") as file:
        write_array(file, np.asarray(values), allow_pickle=True)
    return str(path)


def test_what_is_no_sensor_is_refused_in_a_sentence(tmp_path: Path) -> None:
    grid = {"elevations": [0.0], "azimuth_steps": 10}
    (tmp_path / "list.yaml").write_text("- 1\n")
    (tmp_path / "code.yaml").write_text("!!python/object/apply:os.getcwd []\n")
    (tmp_path / "text.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "empty.csv").touch()
    np.savez(tmp_path / "rays.npz", rays=np.ones((2, 3)))
    (tmp_path / "rays.npz").rename(tmp_path / "npz.npy")
    refused: list[tuple[Any, str]] = [
        ("vlp61", r"must be one of vlp16, os0_32, .*, got 'vlp61': did you mean vlp16"),
        (str(tmp_path / "none.yaml"), r"none.yaml cannot be read \(No such file or directory\)"),
        (str(tmp_path / "list.yaml"), r"list.yaml must hold settings"),
        (str(tmp_path / "code.yaml"), r"code.yaml cannot be read"),
        (("colour", 3), r"has no setting 'colour': it takes like, name, elevations"),
        (("elevations", "high"), r"elevations must be a list of degrees, got 'high'"),
        (("elevations", [91.0]), r"elevations must be a list of angles in \[-90, 90\] degrees; got \[91.0\]"),
        (("azimuth_steps", 0), r"azimuth_steps must be a whole number, 1 or more; got 0"),
        (("azimuth_steps", 10**7), r"would cast 10,000,000 rays, and at most 300,000 are possible"),
        (("rate", 5.0), r"rate must be at least 10 Hz, at which policies act, and at most 1000; got 5.0"),
        (("azimuth", [45, -45]), r"azimuth must be two angles in degrees, the right one first"),
        (("blind_distance", 200.0), r"blind_distance must be 0 or more, and below max_range; got 200.0"),
        (("directions", "rays.csv"), r"needs one kind of rays"),
        (("elevations", [True, False]), r"elevations must be finite numbers"),
        (("mount", 180), r"mount must be a list of degrees, got 180"),
        (("mount", ["up", 0, 0]), r"mount must be finite numbers"),
        (("mount", [180, 0]), r"mount must be roll, pitch and yaw in degrees, .* from -180 to 180; got \[180, 0\]"),
        (("mount", [3.1416, 0, 0]), r"3.1416 looks like radians"),
        (("like", "mid306"), r"like must be one of vlp16, .*, got 'mid306': did you mean mid360"),
        ({"like": "mid360", "rate": 20}, r"A LiDAR like mid360 has its rate, which its rays depend on: leave rate out"),
        ({"like": "vlp16", "rate": 20}, r"A LiDAR like vlp16 has its rate"),
        (("like", "./mine.yaml"), r"got './mine.yaml': choose one of them, or leave like out"),
        (("like", "mid360"), r"A LiDAR like mid360 has its rays: leave elevations and azimuth_steps out"),
    ]
    for given, told in refused:
        with pytest.raises(UavrlError, match=told):
            lidar_sensor(given if isinstance(given, str | dict) else {**grid, given[0]: given[1]})
    for path, told in {
        str(tmp_path / "none.npy"): r"cannot be read \(No such file or directory\): name a file that",
        str(tmp_path / "rays.bin"): r"must be a .csv, .txt or .npy file",
        str(tmp_path / "empty.csv"): r"have the shape \[1, 0, 1\] and type float64: rows must be",
        str(tmp_path / "npz.npy"): r"cannot be read \(it is an NPZ file by its content\): rows must be",
        str(tmp_path / "text.csv"): r"cannot be read \(could not convert",
        _npy(
            tmp_path / "pickled.npy", np.array([{}], dtype=object)
        ): r"cannot be read \(Object arrays cannot be loaded",
        _npy(tmp_path / "flat.npy", np.zeros(3)): r"have the shape \[3\] and type float64: rows must be",
        _npy(tmp_path / "nan.npy", np.full((2, 3), np.nan)): r"hold NaN or infinite values",
        _npy(tmp_path / "zero.npy", np.zeros((2, 3))): r"hold a ray of length 0",
        _npy(
            tmp_path / "zenith.npy", [[0.0, 38.0], [10.0, 97.0]]
        ): r"hold elevations of up to 97 degrees, and 90 is straight up: .*; of zenith angles write 90 - zenith",
        _npy(tmp_path / "many.npy", np.ones((300_001, 3))): r"are 1 scans of 300,001 rays",
        _npy(
            tmp_path / "long.npy", np.ones((201, 2, 3))
        ): r"are 201 scans of 2 rays; at most 200 scans, 300,000 rays in",
    }.items():
        with warnings.catch_warnings(), pytest.raises(UavrlError, match=told):
            warnings.simplefilter("error")
            lidar_sensor({"directions": path})


@pytest.mark.parametrize("other", [{"azimuth": [-10, 10]}, {"azimuth_steps": 36}])
def test_a_setting_that_a_file_of_directions_would_overrule_is_refused(other: dict[str, Any], tmp_path: Path) -> None:
    rays = _npy(tmp_path / "rays.npy", [[0.0, 0.0], [90.0, 0.0]])
    assert lidar_sensor({"directions": rays}).num_rays == 2
    with pytest.raises(UavrlError, match="takes its rays from its file of directions: leave azimuth and"):
        lidar_sensor({"directions": rays, **other})


def test_a_single_step_looks_to_the_middle_of_its_field_of_view() -> None:
    for azimuth, towards in (((-45, 45), [1.0, 0.0, 0.0]), ((0, 90), [0.5**0.5, 0.5**0.5, 0.0])):
        sensor = lidar_sensor({"elevations": [0], "azimuth_steps": 1, "azimuth": list(azimuth)})
        np.testing.assert_allclose(sensor.rays.directions[0, 0], towards, atol=1e-6)


def test_a_sensor_of_ones_own_has_a_name_of_its_own() -> None:
    with pytest.raises(UavrlError, match="The name vlp16 belongs to a LiDAR of uavrl: rename the file"):
        lidar_sensor({"name": "vlp16", "elevations": [0], "azimuth_steps": 90})
