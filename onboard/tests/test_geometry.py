"""The one geometry: each way of turning against SciPy, its reverse, and each test of points by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uavrl_onboard.geometry import (
    Columns,
    attitude_of,
    body_to_world,
    first_least,
    heading_vector,
    hull_distances,
    is_inside,
    is_return,
    off_altitudes,
    quaternion,
    roll_pitch_yaw,
    rotate,
    rotation_about,
    rotations_of,
    turn_about,
    within,
    world_to_yaw,
    yaw_rotation,
    yaw_to_world,
)
from uavrl_onboard.guards.map.grid import grid_graph
from uavrl_onboard.vehicle import Vehicle

ANGLES = (0.3, -0.4, 2.5)  # roll, pitch, yaw in rad
SCIPY = Rotation.from_euler("ZYX", ANGLES[::-1])


def test_all_forms_of_one_rotation_agree_with_scipy() -> None:
    rotation = body_to_world(np.array([ANGLES]))[0]
    x, y, z, w = SCIPY.as_quat()
    np.testing.assert_allclose(rotation, SCIPY.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(np.abs(np.dot(quaternion(*ANGLES), [w, x, y, z])), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotations_of(np.array([[x, y, z, w]]))[0], rotation, atol=1e-12)
    np.testing.assert_allclose(rotate((1.0, 2.0, 3.0), quaternion(*ANGLES)), rotation @ [1.0, 2.0, 3.0], atol=1e-12)
    assert attitude_of(rotation) == pytest.approx(ANGLES)
    assert roll_pitch_yaw(quaternion(*ANGLES)) == pytest.approx(ANGLES)


def test_rodrigues_formula_has_the_same_result_as_a_matrix_and_ray_by_ray() -> None:
    rng = np.random.default_rng(0)
    axis, angles, vectors = rng.normal(size=3), rng.uniform(-4, 4, 50), rng.normal(size=(3, 50))
    axis /= np.linalg.norm(axis)
    matrices = rotation_about(np.tile(axis, (50, 1)), angles)
    np.testing.assert_allclose(matrices, Rotation.from_rotvec(angles[:, None] * axis).as_matrix(), atol=1e-12)
    each = np.einsum("nij,jn->in", matrices, vectors)
    np.testing.assert_allclose(turn_about(vectors, axis, angles), each, atol=1e-12)


@pytest.mark.parametrize("shape", [(4, 3), (4, 2), (4, 5, 3), (4, 5, 6, 3)])
def test_each_vehicles_vectors_turn_by_its_own_yaw_and_back(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    vectors, yaws = rng.normal(size=shape), rng.uniform(-np.pi, np.pi, 4)
    turned = world_to_yaw(vectors, yaws)
    for one, yaw in enumerate(yaws):
        matrix = yaw_rotation(yaw)[: shape[-1], : shape[-1]]
        np.testing.assert_allclose(turned[one], vectors[one] @ matrix, atol=1e-12)
        np.testing.assert_allclose(world_to_yaw(vectors[one], float(yaw)), turned[one], atol=1e-12)
    np.testing.assert_allclose(yaw_to_world(turned, yaws), vectors, atol=1e-12)
    assert heading_vector(yaws) == pytest.approx(np.stack([yaw_rotation(yaw)[:2, 0] for yaw in yaws]))


def test_turning_keeps_single_precision() -> None:
    vectors, yaws = np.ones((2, 3), np.float32), np.zeros(2, np.float32)
    assert world_to_yaw(vectors, yaws).dtype == yaw_to_world(vectors, yaws).dtype == np.float32


def test_a_return_is_finite_outside_the_housing_and_nearer_than_what_counts() -> None:
    points = np.array(
        [[0.04, 0, 0], [0.06, 0, 0], [0, 3.9, 0], [0, 0, 4.1], [0, 0, 0], [np.nan, 0, 0], [3e38, 0, 3e38]]
    )
    assert is_return(points).tolist() == [False, True, True, True, False, False, True]
    assert is_return(points.astype(np.float32)).tolist() == [False, True, True, True, False, False, False]  # overflows
    assert is_return(points, within(4.0)).tolist() == [False, True, True, False, False, False, False]
    assert is_return(np.stack([points, points])).shape == (2, 7)


def test_hull_and_altitudes_are_those_of_the_vehicle() -> None:
    tall = Vehicle(radius=0.5, height=2.0, lowest=-1.0, highest=2.0)
    beside = np.array([[1.5, 0.0, 0.0]])
    assert hull_distances(beside, np.zeros((1, 3)), 0.1, tall.hull).tolist() == pytest.approx([1.0])
    assert hull_distances(np.zeros((0, 3)), np.zeros((2, 5, 3)), 0.1).tolist() == [[np.inf] * 5] * 2
    assert is_inside(np.array([[0.4, 0.0, 0.9], [0.4, 0.0, 1.1], [0.6, 0.0, 0.0]]), tall.hull).tolist() == [1, 0, 0]
    assert off_altitudes(np.array([-1.5, 0.0, 2.5]), tall).tolist() == [0.5, 0.0, 0.5]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("order", ["C", "F"])
def test_columns_hold_the_returns_of_a_scan_however_it_lies_in_memory(dtype: type, share: float, order: Any) -> None:
    rng = np.random.default_rng(0)
    cloud = rng.normal(scale=4.0, size=(500, 3))
    misses = np.flatnonzero(rng.random(500) < share)
    cloud[misses] = np.array([[np.nan] * 3, [0.0] * 3, [np.inf] * 3])[misses % 3]
    cloud = np.asarray(cloud, dtype, order=order)
    columns = Columns.of(cloud)
    np.testing.assert_array_equal(columns.points.T, cloud[is_return(cloud)])
    for farthest in (2.0, 12.0, np.inf):
        np.testing.assert_array_equal(columns.rows(columns.within(farthest)), cloud[is_return(cloud, within(farthest))])


def test_the_first_least_of_each_cell_is_that_of_a_sort_by_cell_and_value() -> None:
    rng = np.random.default_rng(0)
    cells, values = rng.integers(0, 40, 300) * 2, rng.integers(0, 9, 300).astype(float)
    order = np.lexsort((values, cells))
    expected = order[np.flatnonzero(np.diff(cells[order], prepend=-1))]
    np.testing.assert_array_equal(first_least(cells, values, 80), expected)
    assert not len(first_least(cells[:0], values[:0], 80))


def test_a_grids_graph_joins_neighbours_both_ways_and_no_cell_across_a_border() -> None:
    free = np.array([[True, True, False], [True, False, True]])
    graph, index = grid_graph(free.shape, lambda a, b, far: (free[a] & free[b], np.full(free[a].shape, far)))
    first, second = graph.nonzero()
    edges = dict(zip(zip(first.tolist(), second.tolist(), strict=True), graph.data.tolist(), strict=True))
    a, b, c, d = (int(index[cell]) for cell in ((0, 0), (0, 1), (1, 0), (1, 2)))
    diagonal = pytest.approx(math.sqrt(2))
    once = {(a, b): 1.0, (a, c): 1.0, (b, c): diagonal, (b, d): diagonal}
    assert edges == once | {(other, one): far for (one, other), far in once.items()}
