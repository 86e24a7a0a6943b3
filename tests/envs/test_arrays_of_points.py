"""Arrays are read as points where they are points, and refused where they mean something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uavrl.envs.file_worlds import CloudConfig
from uavrl.envs.shape_reader import Unread, read_shape
from uavrl.errors import UavrlError

POINTS = np.random.default_rng(0).uniform(0, 9, (60, 3)).astype(np.float32)


def fields(*names: str) -> np.ndarray:
    found = np.zeros(60, [(name, np.float32) for name in names])
    for name, values in zip(names[-3:], POINTS.T, strict=True):
        found[name] = values
    return found


@pytest.mark.parametrize(
    "array",
    [
        POINTS,
        np.asfortranarray(POINTS),
        np.hstack([POINTS, np.ones((60, 29), np.float32)]),
        POINTS.reshape(6, 10, 3),
        np.dstack([POINTS.reshape(6, 10, 3), np.ones((6, 10, 1), np.float32)]),
        fields("intensity", "x", "y", "z"),
        fields("X", "Y", "Z"),
        fields("x", "y", "z").reshape(6, 10),
    ],
)
def test_any_array_of_points_is_read(array: np.ndarray, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", points=array)
    for name in ("a.npy", "a.npz"):
        np.testing.assert_array_equal(read_shape(tmp_path / name, 2**30)[0], POINTS)


@pytest.mark.parametrize(
    ("array", "told"),
    [
        (POINTS.T, r"shape \[3, 60\] and type float32, and points are \[P, 3\]: transpose it"),
        (np.vstack([POINTS.T, np.ones(60)]), r"shape \[4, 60\] .*: transpose it"),
        (np.ones((48, 64)), r"shape \[48, 64\] .* with at most 32 columns, or have fields x, y and z: save the points"),
        (np.ones((6, 10, 3), np.uint8), r"shape \[6, 10, 3\] and type uint8"),
        (np.ones((6, 10, 64)), r"shape \[6, 10, 64\]"),
        (np.ones(9), r"shape \[9\]"),
        (np.ones((9, 2)), r"shape \[9, 2\]"),
        (np.ones((9, 3), complex), "type complex128"),
        (fields("u", "v", "w"), "or have fields x, y and z"),
    ],
)
def test_an_array_of_something_else_is_refused(array: np.ndarray, told: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(Unread, match=told):
        read_shape(tmp_path / "a.npy", 2**30)


def test_a_whole_array_needs_no_patience(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS.T)
    np.savez(tmp_path / "b.npz", one=POINTS, other=POINTS)
    np.savez(tmp_path / "c.npz")
    (tmp_path / "d.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-9])
    for name, told in (
        ("a.npy", "transpose it"),
        ("b.npz", "the arrays one, other: save"),
        ("c.npz", "no array: save"),
    ):
        with pytest.raises(UavrlError, match=told) as error:
            CloudConfig(file=str(tmp_path / name)).scene(0)
        assert "wait" not in str(error.value) and "export" not in str(error.value)
    with pytest.raises(UavrlError, match=r"if it is still being written, wait; otherwise export it again\.$"):
        CloudConfig(file=str(tmp_path / "d.npy")).scene(0)
