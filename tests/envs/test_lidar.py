"""The VLP-16 against hand-worked scenes and PyBullet's rays."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pybullet
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.geometry import bullet_world
from tests.helpers.scenes import LEVEL, ORIGIN, box, clutter, poses
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.mesh import turned
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl_onboard.lidar.vlp16 import FIRING_TIMES, NUM_RAYS
from uavrl_onboard.mesh import Mesh


def ranges(cloud: np.ndarray) -> np.ndarray:
    return np.linalg.norm(cloud, axis=-1)


WALL = Mesh([[5, -50, -50], [5, 50, -50], [5, 50, 50], [5, -50, 50]], [[0, 1, 2], [0, 2, 3]])  # the plane x = 5
PLANE = Mesh.merge(
    [box((0, 0, 0), (1.2, 0.2, 0.2)), box((0.1, 0, 0), (0.3, 2.0, 0.05)), box((-0.5, 0, 0.2), (0.2, 0.1, 0.4))]
)


def test_firing_order_literally() -> None:
    directions = Lidar([]).directions
    assert directions.shape == (28928, 3) and directions.dtype == np.float32
    # -15, 1 and -13 degrees straight ahead; 0.0083 and 0.0166 degrees to the right
    np.testing.assert_allclose(
        directions[:3],
        [[0.965926, 0.0, -0.258819], [0.999848, -0.000145, 0.017452], [0.974370, -0.000282, -0.224951]],
        atol=1e-6,
    )
    elevations = np.degrees(np.arcsin(directions[:, 2])).reshape(1808, 16)
    expected = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]
    np.testing.assert_allclose(elevations, np.broadcast_to(expected, (1808, 16)), atol=1e-4)
    # a quarter turn takes 25 ms: 452.1 cycles of 55.296 us, and it ends at the right-hand side
    quarter = directions[452 * 16]
    assert quarter[1] < -0.965 and abs(quarter[0]) < 1e-3
    azimuths = np.degrees(np.arctan2(-directions[::16, 1], directions[::16, 0])) % 360
    np.testing.assert_allclose(np.diff(azimuths), 0.1990656, atol=1e-4)
    np.testing.assert_allclose(ranges(directions), 1, atol=1e-6)
    assert FIRING_TIMES[-1] == pytest.approx(0.1, abs=1e-4)
    with pytest.raises(ValueError, match="read-only"):
        directions[0] = 0


def test_wall_at_a_known_distance() -> None:
    lidar = Lidar([WALL])
    cloud = lidar.scan(np.array([[0.0, 0, 0], [3, 7, 0], [6, 0, 0]]), np.repeat(LEVEL, 3, 0))
    assert cloud.shape == (3, NUM_RAYS, 3) and cloud.dtype == np.float32
    ahead = lidar.directions[:, 0] > 0.2
    np.testing.assert_allclose(cloud[0, ahead, 0], 5, atol=1e-4)
    np.testing.assert_allclose(cloud[1, ahead, 0], 2, atol=1e-4)
    assert np.isnan(cloud[0, lidar.directions[:, 0] < 0]).all()
    np.testing.assert_allclose(cloud[2, lidar.directions[:, 0] < -0.2, 0], -1, atol=1e-4)  # seen from behind
    misses = np.isnan(cloud)
    assert (misses.all(-1) == misses.any(-1)).all()


def test_the_scan_tilts_with_the_body() -> None:
    """Pitched 30° nose down, 2 m over flat ground, the forward rays at ±1° meet it after 2 / sin(30° ∓ 1°)."""
    ground = Mesh([[-99, -99, 0], [99, -99, 0], [99, 99, 0], [-99, 99, 0]], [[0, 1, 2], [0, 2, 3]])
    down = np.reshape(
        pybullet.getMatrixFromQuaternion(pybullet.getQuaternionFromEuler((0, math.radians(30), 0))), (1, 3, 3)
    )
    lidar = Lidar([ground])
    cloud = lidar.scan([[0, 0, 2]], down)
    got = ranges(cloud[0, [1, 14]])  # lasers at +1° and -1°
    np.testing.assert_allclose(got, [2 / math.sin(math.radians(29)), 2 / math.sin(math.radians(31))], rtol=1e-4)
    assert np.isnan(cloud[0, 904 * 16 + 1]).all()  # behind: up into the sky
    world = cloud[0] @ down[0].T + [0, 0, 2]
    np.testing.assert_allclose(world[~np.isnan(world[:, 2]), 2], 0, atol=2e-3)


def pybullet_ranges(meshes: list[Mesh], rays: np.ndarray, lengths: float) -> np.ndarray:
    """Ranges of rays ``[M, 2, 3]`` (origin, unit direction), NaN for misses."""
    client, _ = bullet_world(meshes)
    hits = []
    for part in np.array_split(rays, math.ceil(len(rays) / 8192)):
        hits += client.rayTestBatch(part[:, 0].tolist(), (part[:, 0] + lengths * part[:, 1]).tolist())
    client.disconnect()
    return np.array([lengths * hit[2] if hit[0] >= 0 else np.nan for hit in hits])


@pytest.mark.parametrize("max_range", [4.0, 60.0])
def test_agrees_with_pybullet_and_sees_moving_planes(max_range: float) -> None:
    meshes = clutter(0)
    positions, rotations = poses(1, 3)
    ahead = rotations[:, :, 0]
    planes = np.array(
        [[*(positions[0] + 2.5 * ahead[0]), 0.7], [*(positions[1] - 3 * ahead[1]), -2.0], [30, 30, 3.5, 1]]
    )
    lidar = Lidar(meshes, PLANE, LidarConfig(max_range=max_range))
    got = ranges(lidar.scan(positions, rotations, planes))
    without = ranges(lidar.scan(positions, rotations))
    shortened = (got < without - 1e-3) | (np.isnan(without) & ~np.isnan(got))
    assert shortened[0].sum() > 100 and shortened[1].sum() > 50
    assert not (got > without + 1e-6).any()
    rng = np.random.default_rng(2)
    for i in range(3):
        seen = np.flatnonzero(shortened[i])
        some = np.unique(np.concatenate([rng.choice(NUM_RAYS, 1500, replace=False), seen[:1500]]))
        directions = lidar.directions[some] @ rotations[i].T
        rays = np.stack([np.broadcast_to(positions[i], directions.shape), directions], 1)
        bodies = [turned(PLANE, yaw).translated((x, y, z)) for x, y, z, yaw in planes]
        expected = pybullet_ranges([*meshes, *bodies], rays, max_range)
        close = np.isclose(got[i, some], expected, atol=3e-3, rtol=1e-3, equal_nan=True)
        assert close.mean() > 0.995  # rays that graze an edge may differ


def test_a_plane_is_seen_from_within_its_bounding_sphere_and_not_beyond_range() -> None:
    lidar = Lidar([], PLANE, LidarConfig(max_range=4.0))
    near = lidar.scan(ORIGIN, LEVEL, np.array([[0.8, 0, 0, 0]]))  # its tail is 0.2 m ahead, at -0.6 - 0.0
    assert np.nanmin(ranges(near)) == pytest.approx(0.2, abs=5e-3)
    assert np.isnan(lidar.scan(ORIGIN, LEVEL, np.array([[4.7, 0, 0, 0]]))).all()  # its tail is 4.1 m ahead
    assert not np.isnan(lidar.scan(ORIGIN, LEVEL, np.array([[4.5, 0, 0, 0]]))).all()
    behind = lidar.scan(ORIGIN, LEVEL, np.array([[-3, 0, 0, math.pi / 2]]))
    assert np.nanmax(behind[..., 0]) < -2


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 2.5, 7.3]), st.sampled_from(["face", "range", "proximity"]))
def test_a_cut_range_leaves_the_reduction_identical(seed: int, radius: float, statistic: str) -> None:
    meshes = clutter(seed)
    positions, rotations = poses(seed, 2)
    planes = np.column_stack([positions + np.array([1.5, 1.0, 0.1]), [0.3, 2.0]])
    clouds = [
        torch.from_numpy(Lidar(meshes, PLANE, LidarConfig(max_range=reach)).scan(positions, rotations, planes))
        for reach in (radius, 100.0)
    ]
    assert clouds[0].isnan().sum() >= clouds[1].isnan().sum()
    cut, uncut = (truncated_icosahedron(cloud, radius, statistic) for cloud in clouds)
    assert cut.equal(uncut)
    assert cut.any()


def test_noise_and_dropout_statistics() -> None:
    clean = ranges(Lidar([WALL]).scan(ORIGIN, LEVEL))
    lidar = Lidar([WALL], None, LidarConfig(range_noise=0.01, dropout=0.2))
    spoilt = lidar.scan(ORIGIN, LEVEL, rng=np.random.default_rng(0))
    error = (ranges(spoilt) - clean)[~np.isnan(clean)]
    assert np.isnan(error).mean() == pytest.approx(0.2, abs=0.015)
    assert np.nanstd(error) == pytest.approx(0.01, rel=0.05)
    assert np.nanmean(error) == pytest.approx(0, abs=5e-4)
    directions = spoilt / ranges(spoilt)[..., None]
    hit = ~np.isnan(directions).any(-1)
    np.testing.assert_allclose(directions[hit], lidar.directions[None][hit], atol=1e-5)  # along the ray only
    again = lidar.scan(ORIGIN, LEVEL, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(spoilt, again)


def test_minimum_range() -> None:
    cloud = Lidar([WALL], None, LidarConfig(min_range=6.0)).scan(ORIGIN, LEVEL)
    plain = Lidar([WALL]).scan(ORIGIN, LEVEL)
    np.testing.assert_array_equal(np.isnan(cloud), np.isnan(plain) | (ranges(plain) < 6)[..., None])


def test_motion_distortion_of_a_moving_and_of_a_turning_sensor() -> None:
    lidar = Lidar([WALL], None, LidarConfig(motion_distortion=True))
    ahead = lidar.directions[:, 0] > 0.2
    still = np.zeros((1, 3))
    moving = lidar.scan(ORIGIN, LEVEL, velocities=[[2.0, 1, 0]], angular_velocities=still)
    # at 2 m/s the wall comes nearer by 2 t: from 5 m at the first firing to 4.8 m at the last
    np.testing.assert_allclose(moving[0, ahead, 0], (5 - 2 * FIRING_TIMES)[ahead], atol=1e-4)
    turning = lidar.scan(ORIGIN, LEVEL, velocities=still, angular_velocities=[[0, 0, 1.5]])
    x, y, _ = lidar.directions.astype(float).T
    towards = x * np.cos(1.5 * FIRING_TIMES) - y * np.sin(1.5 * FIRING_TIMES)  # the ray's world x, turned left by 1.5 t
    ahead &= towards > 0.2
    np.testing.assert_allclose(ranges(turning)[0, ahead], 5 / towards[ahead], rtol=1e-4)
    plain = Lidar([WALL]).scan(ORIGIN, LEVEL)
    np.testing.assert_allclose(lidar.scan(ORIGIN, LEVEL, velocities=still, angular_velocities=still), plain, rtol=1e-5)


def test_motion_distortion_moves_the_sensor_past_planes() -> None:
    lidar = Lidar([], PLANE, LidarConfig(motion_distortion=True))
    velocity = np.array([[40.0, 0, 0]])
    cloud = lidar.scan(
        ORIGIN, LEVEL, np.array([[9.0, 1, 0, 0]]), velocities=velocity, angular_velocities=np.zeros((1, 3))
    )
    hit = np.flatnonzero(~np.isnan(cloud[0, :, 0]))
    assert len(hit) > 10
    world = cloud[0, hit] + velocity * FIRING_TIMES[hit, None] - [9, 1, 0]
    assert (np.abs(world) <= [0.61, 1.01, 0.41]).all()  # every point lies on the plane


@pytest.mark.parametrize("distorted", [False, True])
def test_scans_of_several_vehicles_are_those_of_each_alone(distorted: bool) -> None:
    lidar = Lidar(clutter(1), PLANE, LidarConfig(max_range=9.0, motion_distortion=distorted))
    positions, rotations = poses(2, 4)
    moves = {
        name: np.random.default_rng(i).normal(size=(4, 3))
        for i, name in enumerate(("velocities", "angular_velocities"))
    }
    planes = np.column_stack([positions[:2] + np.array([1.5, 0.5, 0.2]), [0.3, 2.0]])
    together = lidar.scan(positions, rotations, planes, **moves)
    kept = together.copy()
    assert not np.array_equal(lidar.scan(positions, rotations, **moves), together, equal_nan=True)
    for i in range(4):
        some = {name: values[i : i + 1] for name, values in moves.items()}
        alone = lidar.scan(positions[i : i + 1], rotations[i : i + 1], planes, **some)
        np.testing.assert_array_equal(alone[0], together[i])
    np.testing.assert_array_equal(kept, together)  # earlier scans stay as they are
    none = {name: values[:0] for name, values in moves.items()}
    assert lidar.scan(positions[:0], rotations[:0], **none).shape == (0, NUM_RAYS, 3)


@pytest.mark.parametrize("remake", [copy.deepcopy, lambda lidar: pickle.loads(pickle.dumps(lidar))])
def test_copies_see_the_same(remake) -> None:
    lidar = Lidar(clutter(5), PLANE, LidarConfig(max_range=9.0))
    positions, rotations = poses(6, 1)
    np.testing.assert_array_equal(remake(lidar).scan(positions, rotations), lidar.scan(positions, rotations))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"positions": [[0, 0, np.nan]]}, "positions must be finite"),
        ({"rotations": LEVEL * np.nan}, "rotations must be finite"),
        ({"rotations": LEVEL * 2}, "orthonormal"),
        ({"positions": [0, 0, 0]}, "positions must have shape"),
        ({"rotations": np.eye(3)}, "rotations must have shape"),
        ({"moving_poses": [[0, 0, 0]]}, "moving_poses must have shape"),
        ({"moving_poses": [[0, 0, 0, np.inf]]}, "moving_poses must be finite"),
        ({"moving_poses": [[0, 0, 0, 0]], "moving": None}, "moving mesh"),
        ({"config": LidarConfig(dropout=0.1)}, "need rng"),
        ({"config": LidarConfig(motion_distortion=True)}, "velocities is needed"),
    ],
)
def test_wrong_arguments(arguments: dict, message: str) -> None:
    scan = {"positions": ORIGIN, "rotations": LEVEL, **arguments}
    lidar = Lidar([WALL], scan.pop("moving", PLANE), scan.pop("config", None))
    with pytest.raises(ValueError, match=message):
        lidar.scan(**scan)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_range", 0.0),
        ("max_range", math.inf),
        ("min_range", -1.0),
        ("min_range", 100.0),
        ("range_noise", -0.1),
        ("range_noise", math.nan),
        ("dropout", 1.0),
    ],
)
def test_wrong_config(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be "):
        LidarConfig(**{name: value})


@pytest.mark.parametrize("near", [4.0, 9.0, 11.0])
def test_every_fifth_firing_cycle_looks_farther_and_the_others_as_before(near: float) -> None:
    (position, rotation), plane = poses(3, 2), np.array([[1.0, 6.5, 2.0, 0.3], [-3.0, 2.0, 3.0, 1.0]])
    scenes, far = clutter(3), np.zeros((1808, 16), bool)
    far[::5] = True
    cut, mixed, full = (
        Lidar(scenes, PLANE, LidarConfig(max_range=reach, far_range=farther)).scan(position, rotation, plane)
        for reach, farther in ((near, None), (near, 12.0), (12.0, None))
    )
    far = far.ravel()
    assert np.array_equal(mixed[:, ~far], cut[:, ~far], equal_nan=True)
    assert np.array_equal(mixed[:, far], full[:, far], equal_nan=True)
    assert (np.nan_to_num(ranges(mixed[:, far])) > near).any()
    reduced = [truncated_icosahedron(torch.from_numpy(cloud.copy()), near) for cloud in (cut, mixed, full)]
    assert torch.equal(reduced[0], reduced[1]) and torch.equal(reduced[0], reduced[2])


def test_a_far_range_that_is_no_farther_changes_nothing() -> None:
    """It is how far every fifth firing cycle reaches at least."""
    (position, rotation), scenes = poses(3, 2), clutter(3)
    plain, nearer = (Lidar(scenes, config=LidarConfig(max_range=9.0, far_range=far)) for far in (None, 3.0))
    assert np.array_equal(plain.scan(position, rotation), nearer.scan(position, rotation), equal_nan=True)


@pytest.mark.parametrize("far", [0.0, -1.0, float("nan"), float("inf")])
def test_the_far_range_is_none_or_a_length(far: float) -> None:
    with pytest.raises(ValueError, match=r"far_range must be a (positive length in metres|finite number)"):
        LidarConfig(max_range=4.0, far_range=far)
