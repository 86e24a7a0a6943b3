"""Simulated scans of clutter, from tilted sensors, and what the reductions should make of them after a round trip."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tests.helpers.scenes import clutter, poses
from uavrl.envs.lidar import Lidar
from uavrl_onboard.geometry import NEAREST_RETURN
from uavrl_onboard.perception.cells import icosahedron
from uavrl_onboard.perception.reductions import REDUCTIONS

MM2 = 0.002 + 1e-6  # m


def tilted_scans(number: int, seed: int = 0) -> Iterator[np.ndarray]:
    """Scans ``[28928, 3]`` with misses, of sensors that lean up to half a radian."""
    lidar = Lidar(clutter(seed))
    positions, rotations = poses(seed, number)
    for position, rotation in zip(positions, rotations, strict=True):
        yield lidar.scan(position[None], rotation[None])[0]


def on_a_border(points: np.ndarray, reduction: str) -> np.ndarray:
    """Which points ``[P, 3]`` lie so near to the border of a cell, or of the ball, that rounding may move them over."""
    if reduction == "range_image":
        side = (
            np.abs(np.arctan2(points[:, 1], points[:, 0]) / np.radians(15) % 1 - 0.5) < 0.001
        )  # rows have no borders near a laser
        return side | (np.abs(np.linalg.norm(points, axis=1) - 4.0) < MM2)
    faces = icosahedron(4.0)
    heights = points @ faces.normals.T
    two = np.sort(faces.offsets * (faces.offsets - 2 * heights), axis=1)[:, :2]  # squared distances to the centres
    return (np.abs(heights - faces.offsets).min(1) < MM2) | (two[:, 1] - two[:, 0] < 8 * MM2)


def same_after(decode: Callable[[np.ndarray], np.ndarray], scan: np.ndarray) -> dict[str, float]:
    """Checks a decoded scan point by point and cell by cell; returns the share of rays on the border of two cells.

    A point on the border of two cells, or of the ball, is left out of both scans where cells are compared: to which of
    them it belongs, the last digit says.
    """
    far = np.linalg.norm(np.nan_to_num(scan), axis=1)
    scan = np.where(((far > NEAREST_RETURN + MM2) & (far < 131.07))[:, None], scan, np.nan)
    hit = ~np.isnan(scan[:, 0])
    true, found = scan[hit].astype(np.float64), decode(scan).astype(np.float64)
    assert found.shape == true.shape
    ranges, measured = np.linalg.norm(true, axis=1), np.linalg.norm(found, axis=1)
    np.testing.assert_allclose(measured, ranges, rtol=1e-6, atol=MM2 / 2)
    turned = np.linalg.norm(found / measured[:, None] - true / ranges[:, None], axis=1)
    assert np.degrees(turned).max() < 0.0125
    near = ranges < 4.01
    true, found = true[near], found[near]
    assert np.linalg.norm(found - true, axis=1).max() < MM2
    borders = {}
    for name, reduce in REDUCTIONS.items():
        stays = ~on_a_border(true, name)
        borders[name] = float(1 - stays.mean())
        for statistic in ("face", "range", "proximity"):
            cells = [reduce(cloud[stays].astype(np.float32), 4.0, statistic) for cloud in (true, found)]
            np.testing.assert_allclose(cells[1], cells[0], rtol=0, atol=MM2, err_msg=f"{name} {statistic}")
    return borders
