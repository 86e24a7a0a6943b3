"""The reduction against hand-worked values and a slow oracle; its transform against TorchRL's contract."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from tests.helpers.clouds import CloudEnv, OfClouds
from tests.helpers.contracts import TransformContract
from uavrl.transforms.icosahedron import TruncatedIcosahedron, truncated_icosahedron, truncated_icosahedron_faces

PHI = (1 + 5**0.5) / 2
NAN = math.nan


def oracle_vertices(radius: float) -> np.ndarray:
    """The 60 vertices: even permutations of (0, ±1, ±3φ), (±1, ±(2 + φ), ±2φ) and (±φ, ±2, ±(2φ + 1)), scaled."""
    vertices = set()
    for a, b, c in ((0.0, 1.0, 3 * PHI), (1.0, 2 + PHI, 2 * PHI), (PHI, 2.0, 2 * PHI + 1)):
        for triple in ((a, b, c), (b, c, a), (c, a, b)):
            for signs in np.ndindex(2, 2, 2):
                vertices.add(tuple(0.0 + v * (1 - 2 * s) for v, s in zip(triple, signs, strict=True)))
    cloud = np.array(sorted(vertices))
    assert cloud.shape == (60, 3)
    return cloud * (radius / np.linalg.norm(cloud, axis=1, keepdims=True))


def oracle_faces(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals and offsets from the convex hull of the 60 vertices, in the documented order, in float64."""
    cloud = oracle_vertices(radius)
    planes = np.unique(ConvexHull(cloud).equations.round(8), axis=0)
    assert planes.shape == (32, 4)
    touching = (np.abs(cloud @ planes[:, :3].T + planes[:, 3]) < 1e-6).sum(0)
    azimuth = np.arctan2(planes[:, 1], planes[:, 0]).round(6) % (2 * np.pi)
    order = np.lexsort((azimuth, planes[:, 2].round(6), touching))
    assert sorted(touching) == [5] * 12 + [6] * 20
    return planes[order, :3], -planes[order, 3]


def oracle(points: np.ndarray, radius: float, statistic: str) -> tuple[np.ndarray, bool]:
    """Loops over the points of one cloud; also says whether some point is too close to a border to judge."""
    normals, offsets = oracle_faces(radius)
    centres = offsets[:, None] * normals
    least, close = [math.inf] * 32, False
    for point in points.astype(np.float64):
        if not np.isfinite(point).all() or np.linalg.norm(point) <= 0.05:
            continue
        close |= abs(np.linalg.norm(point) - 0.05) < 1e-6
        gap = (normals @ point - offsets).max()
        distances = np.linalg.norm(point - centres, axis=1)
        close |= abs(gap) < 1e-5 * radius
        if gap > 0:
            continue
        first, second = np.sort(distances)[:2]
        close |= second - first < 1e-5 * radius
        face = int(distances.argmin())
        value = first if statistic == "face" else np.linalg.norm(point)
        least[face] = min(least[face], max(value, 1e-6 * radius))
    if statistic == "proximity":
        return np.array([max(radius - value, 0.0) for value in least]), close
    return np.array([0.0 if value == math.inf else value for value in least]), close


def test_faces_match_the_convex_hull() -> None:
    normals, offsets = oracle_faces(4.0)
    faces = truncated_icosahedron_faces(4.0, dtype=torch.float64)
    np.testing.assert_allclose(faces.normals.numpy(), normals, atol=1e-7)
    np.testing.assert_allclose(faces.offsets.numpy(), offsets, atol=1e-7)
    np.testing.assert_allclose(faces.centres.numpy(), offsets[:, None] * normals, atol=1e-7)


def test_face_order_literally() -> None:
    """Pentagons, then hexagons; each from low to high, and counter-clockwise from straight ahead."""
    s, p = 1 / math.hypot(1, PHI), PHI / math.hypot(1, PHI)  # 0.5257, 0.8507
    pentagons = [
        [0, s, -p], [0, -s, -p], [p, 0, -s], [-p, 0, -s],
        [s, p, 0], [-s, p, 0], [-s, -p, 0], [s, -p, 0],
        [p, 0, s], [-p, 0, s], [0, s, p], [0, -s, p],
    ]  # fmt: skip
    u, a, b = 1 / 3**0.5, 1 / PHI / 3**0.5, PHI / 3**0.5  # 0.5774, 0.3568, 0.9342
    hexagons = [
        [a, 0, -b], [-a, 0, -b],
        [u, u, -u], [-u, u, -u], [-u, -u, -u], [u, -u, -u],
        [0, b, -a], [0, -b, -a],
        [b, a, 0], [-b, a, 0], [-b, -a, 0], [b, -a, 0],
        [0, b, a], [0, -b, a],
        [u, u, u], [-u, u, u], [-u, -u, u], [u, -u, u],
        [a, 0, b], [-a, 0, b],
    ]  # fmt: skip
    torch.testing.assert_close(truncated_icosahedron_faces().normals, torch.tensor(pentagons + hexagons))


@pytest.mark.parametrize(
    ("point", "face", "by_face", "by_range"),
    [
        # d_hexagon = 3.6598, d_pentagon = 3.7569 for circumradius 4
        ((1.0, 1.0, 1.0), 26, 3.6598 - 3**0.5, 3**0.5),  # on hexagon 26's axis
        ((0.0, 0.5257, -0.8507), 0, 2.7569, 1.0),  # on pentagon 0's axis
        ((0.0, -3.5 * 0.5257, 3.5 * 0.8507), 11, 0.2569, 3.5),
        # Between pentagon 2 (0.8507, 0, -0.5257) and pentagon 8, nearer the edge of hexagons 20 and 23: the left one.
        # Centre 20 = 3.6598 (0.9342, 0.3568, 0) = (3.4189, 1.3059, 0); offset (0.4189, 1.2059, 0): 1.2766.
        ((3.0, 0.1, 0.0), 20, 1.2766, 3.0017),
    ],
)
def test_single_points_literally(point: tuple[float, ...], face: int, by_face: float, by_range: float) -> None:
    for statistic, value in (("face", by_face), ("range", by_range), ("proximity", 4.0 - by_range)):
        expected = torch.zeros(32)
        expected[face] = value
        got = truncated_icosahedron(torch.tensor([point]), 4.0, statistic)
        torch.testing.assert_close(got, expected, atol=2e-4, rtol=0)


def test_least_distance_wins_and_planes_cut() -> None:
    axis = truncated_icosahedron_faces().normals[[5, 30]]
    cloud = torch.cat([r * axis for r in (1.0, 3.0, 3.7, 3.8, 50.0)])  # 3.7: in the pentagon's ball part only
    got = truncated_icosahedron(cloud)
    assert got.nonzero()[:, 0].tolist() == [5, 30]
    torch.testing.assert_close(got[[5, 30]], torch.tensor([0.0569, 0.6598]), atol=1e-4, rtol=0)
    by_range = truncated_icosahedron(cloud, statistic="range")
    torch.testing.assert_close(by_range[[5, 30]], torch.tensor([1.0, 1.0]))
    by_proximity = truncated_icosahedron(cloud, statistic="proximity")
    torch.testing.assert_close(by_proximity[[5, 30]], torch.tensor([3.0, 3.0]))
    assert by_proximity.count_nonzero() == 2


def test_a_touching_point_does_not_read_empty() -> None:
    faces = truncated_icosahedron_faces()
    got = truncated_icosahedron(faces.centres * (1 - 1e-7))
    assert (got > 0).all() and (got < 1e-5).all()


@pytest.mark.parametrize("radius", [4.0, 2.5, 7.3])
def test_a_point_as_far_as_the_vertices_is_outside_whatever_rounding_does(radius: float) -> None:
    """A LiDAR cut to the circumradius does not report such a point, so it must not count in an uncut scan either."""
    vertices = torch.tensor(oracle_vertices(radius) / radius, dtype=torch.float32)
    jitter = 1e-7 * torch.randn(200, 60, 3, generator=torch.Generator().manual_seed(0))
    directions = torch.nn.functional.normalize(vertices + jitter, dim=-1)
    assert not truncated_icosahedron(directions * radius, radius).any()
    assert truncated_icosahedron(directions * radius * (1 - 1e-5), radius).any()


def test_misses_and_empty_clouds_are_zero() -> None:
    inf = math.inf
    misses = torch.tensor(
        [[NAN] * 3, [inf] * 3, [-inf, 0, 0], [NAN, 0, 0], [0, 0, inf], [1e30, 0, 0], [3.95, 0, 0], [0] * 3]
    )
    assert not truncated_icosahedron(misses).any()
    assert truncated_icosahedron(torch.empty(2, 0, 3)).equal(torch.zeros(2, 32))
    assert truncated_icosahedron(torch.empty(0, 7, 3)).shape == (0, 32)
    assert truncated_icosahedron(torch.empty(0, 3)).equal(torch.zeros(32))


clouds = st.tuples(
    st.integers(0, 2**32 - 1),
    st.integers(0, 40),
    st.sampled_from([0.3, 1.0, 4.0, 17.0]),
    st.sampled_from(["face", "range", "proximity"]),
)


@settings(max_examples=60, deadline=None)
@given(clouds, st.sampled_from([torch.float32, torch.float64]))
def test_agrees_with_the_oracle(cloud: tuple[int, int, float, str], dtype: torch.dtype) -> None:
    seed, size, radius, statistic = cloud
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(size, 3)) * rng.choice([0.2, 0.6, 1.0]) * radius
    points[rng.random(size) < 0.1] = NAN
    points = torch.tensor(points, dtype=dtype)
    expected, close = oracle(points.numpy(), radius, statistic)
    got = truncated_icosahedron(points, radius, statistic)
    assert got.dtype == dtype
    if not close:
        np.testing.assert_allclose(got.numpy(), expected, atol=1e-5 * radius)


@settings(max_examples=40, deadline=None)
@given(clouds)
def test_invariances(cloud: tuple[int, int, float, str]) -> None:
    """Order of points, misses among them, the batch and the memory layout change nothing, to the last bit."""
    seed, size, radius, statistic = cloud
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(3, 2, size, 3, generator=generator) * radius * 0.7
    points += 0.1 * points.sign()  # outside the sensor's housing, which does not grow with the ball
    whole = truncated_icosahedron(points, radius, statistic)
    assert whole.shape == (3, 2, 32)
    assert ((whole >= 0) & (whole <= radius)).all()
    shuffled = points[..., torch.randperm(size, generator=generator), :]
    padded = torch.cat([torch.full((3, 2, 5, 3), NAN), shuffled], dim=-2)
    assert truncated_icosahedron(padded, radius, statistic).equal(whole)
    planar = points.movedim(-1, 0).contiguous().movedim(0, -1)
    assert truncated_icosahedron(planar, radius, statistic).equal(whole)
    for i, j in np.ndindex(3, 2):
        assert truncated_icosahedron(points[i, j], radius, statistic).equal(whole[i, j])
    # powers of two scale exactly
    assert truncated_icosahedron(points * 2, radius * 2, statistic).equal(whole * 2)


@pytest.mark.parametrize("signs", [signs for signs in itertools.product((1, -1), repeat=3) if min(signs) < 0])
@pytest.mark.parametrize("statistic", ["face", "range", "proximity"])
def test_mirroring_permutes_the_faces_to_the_last_bit(signs: tuple[int, int, int], statistic: str) -> None:
    """The planes x = 0, y = 0 and z = 0 mirror the solid onto itself."""
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)) * 2
    normals = truncated_icosahedron_faces().normals
    mirror = torch.tensor(signs, dtype=torch.float32)
    to = (normals * mirror @ normals.T).argmax(-1)
    got = truncated_icosahedron(points, statistic=statistic)
    assert got.count_nonzero() == 32
    assert truncated_icosahedron(points * mirror, statistic=statistic)[to].equal(got)


def test_turning_the_axes_permutes_the_faces() -> None:
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 2
    normals = truncated_icosahedron_faces(dtype=torch.float64).normals
    to = (normals.roll(1, -1) @ normals.T).argmax(-1)
    torch.testing.assert_close(truncated_icosahedron(points.roll(1, -1))[to], truncated_icosahedron(points))


def test_gradient_reaches_the_nearest_point_also_after_inference_mode() -> None:
    with torch.inference_mode():
        truncated_icosahedron(torch.ones(1, 3), 5.0)
    points = torch.tensor([[1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [9.0, 9.0, 9.0]], requires_grad=True)
    truncated_icosahedron(points, 5.0).sum().backward()
    torch.testing.assert_close(points.grad[0], torch.full((3,), -(3**-0.5)))
    assert not points.grad[1:].any()


@pytest.mark.gpu
def test_gpu_agrees() -> None:
    points = torch.randn(8, 28928, 3, generator=torch.Generator().manual_seed(0)) * 6
    torch.testing.assert_close(truncated_icosahedron(points.cuda()).cpu(), truncated_icosahedron(points))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((torch.zeros(5, 2),), "shape"),
        ((torch.zeros(5, 4),), r"got \(5, 4\): pass points\[\.\.\., :3\]"),
        ((torch.zeros(3),), "shape"),
        ((torch.zeros(5, 3, dtype=torch.int64),), "float32 or float64"),
        ((torch.zeros(5, 3), 0.0), "radius"),
        ((torch.zeros(5, 3), NAN), "radius"),
        ((torch.zeros(5, 3), 4.0, "mean"), "statistic"),
    ],
)
def test_wrong_arguments(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        truncated_icosahedron(*arguments)


class TestTransform(OfClouds, TransformContract):
    def make_transform(self) -> TruncatedIcosahedron:
        return TruncatedIcosahedron()

    @pytest.mark.parametrize("batch_size", [(), (2, 3)])
    def test_the_cloud_is_dropped_and_faces_are_bounded(self, batch_size: tuple[int, ...]) -> None:
        env = TransformedEnv(CloudEnv(batch_size), TruncatedIcosahedron())
        assert env.observation_spec["faces"].shape == (*batch_size, 32)
        assert env.observation_spec["faces"].space.high.max() == 4.0
        check_env_specs(env)
        keys = env.rollout(3, break_when_any_done=False).keys(True, True)
        assert {"faces", ("next", "faces")} <= set(keys)
        assert not [key for key in keys if "point_cloud" in (key if isinstance(key, tuple) else (key,))]

    def test_kept_cloud_agrees_with_the_function(self) -> None:
        env = TransformedEnv(CloudEnv((2,)), TruncatedIcosahedron(del_keys=False, radius=6.0, statistic="range"))
        check_env_specs(env)
        rollout = env.rollout(2)
        assert rollout["faces"].equal(truncated_icosahedron(rollout["point_cloud"], 6.0, "range"))

    def test_nested_keys_and_the_same_key_in_and_out(self) -> None:
        keys = {"in_keys": [("sensors", "cloud")], "out_keys": [("sensors", "faces")]}
        env = TransformedEnv(CloudEnv((2,), key=("sensors", "cloud")), TruncatedIcosahedron(**keys))
        check_env_specs(env)
        assert set(env.rollout(2)["sensors"].keys()) == {"faces"}
        env = TransformedEnv(CloudEnv(), TruncatedIcosahedron(out_keys=["point_cloud"]))
        check_env_specs(env)
        assert env.reset()["point_cloud"].shape == (32,)

    def test_by_keyword_and_of_a_missing_cloud(self) -> None:
        clouds = torch.randn(4, 5, 60, 3)
        assert TruncatedIcosahedron()(point_cloud=clouds).equal(truncated_icosahedron(clouds))
        with pytest.raises(KeyError, match="point_cloud"):
            TruncatedIcosahedron()(TensorDict({}, [4]))

    def test_wrong_arguments(self) -> None:
        with pytest.raises(ValueError, match="radius"):
            TruncatedIcosahedron(radius=-1.0)
        with pytest.raises(ValueError, match="statistic"):
            TruncatedIcosahedron(statistic="mean")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="pair up"):
            TruncatedIcosahedron(in_keys=["a", "b"])
        with pytest.raises(KeyError, match="TruncatedIcosahedron reads 'lidar', but the environment emits only"):
            _ = TransformedEnv(CloudEnv(), TruncatedIcosahedron(in_keys=["lidar"])).observation_spec


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: truncated_icosahedron([[1.0, 2.0, 3.0]]), "points must be a tensor .* got a list"),
        (lambda: truncated_icosahedron(torch.zeros(1, 3), radius=1e30), "radius must be a positive length"),
        (lambda: truncated_icosahedron(torch.zeros(1, 3), radius="a"), "radius must be a positive length.* got 'a'"),
        (lambda: TruncatedIcosahedron(radius=None), "radius must be a positive length.* got None"),
    ],
)
def test_arguments_of_another_type_are_refused_in_a_sentence(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()
