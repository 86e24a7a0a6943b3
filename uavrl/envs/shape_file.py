"""A file of a user's: found, read safely, brought to metres with z up, or refused in a sentence."""

import logging
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from uavrl.envs import shape_reader
from uavrl.envs.array_file import load_npy
from uavrl.envs.polygons import OPENING
from uavrl.errors import MissingExtra, UavrlError

log = logging.getLogger(__name__)
Up = Literal["x", "y", "z"]
MOST_BYTES = 2**30  # of a file
MOST_MEMORY = 8 * 2**30  # that reading may take
PATIENCE = 600.0  # s, for reading
SETTLED = 2.0  # s, since the last change of a file that nobody writes any more
LARGEST_EXTENT, LEAST_EXTENT = 5000.0, 3.0  # m
COARSE = 0.02  # m, step of rounded coordinates from which on it is told
TURNED: dict[Up, tuple[int, int, int]] = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}  # the file's axes, z up
COLUMN = 1.0  # m, side of the columns in which surfaces lie above each other
FACES = 0.1  # least z of the unit normal of a surface that faces up: a wall does not
OPEN = 0.1  # share of what faces up and down by which both differ in an open surface
SAMPLES = 16  # of a surface in a column, so that hardly any column misses one of its surfaces


class Surface(NamedTuple):
    """Points on a surface, in metres with z up.

    Attributes:
        points: ``[P, 3]``.
        facing: z of the unit normal ``[P]`` of each; None where the file does not tell.
    """

    points: np.ndarray
    facing: np.ndarray | None = None

    def only(self, these: np.ndarray) -> "Surface":
        """Those points that a mask ``bool [P]`` chooses."""
        return Surface(self.points[these], None if self.facing is None else self.facing[these])


def require_file(file: str, suffixes: tuple[str, ...], key: str = "env.world.file") -> Path:
    """The file that a user names."""
    path = Path(file).expanduser()
    known = ", ".join(suffix[1:].upper() for suffix in suffixes)
    if path.is_dir():
        raise UavrlError(f"{path} is a folder: name a file ({known}) with {key}.")
    if not path.is_file():
        raise UavrlError(f"There is no file {path}: name one with {key}.")
    if path.suffix.lower() not in suffixes:
        other = " (env=cloud reads point clouds)" if path.suffix.lower() in shape_reader.CLOUDS else ""
        other = " (env=mesh reads meshes)" if path.suffix.lower() in shape_reader.MESHES else other
        raise UavrlError(f"{path} is no {known}, by its name{other}: convert it, or name another file.")
    size = path.stat().st_size
    if size == 0:
        raise UavrlError(f"{path} is empty: wait until it is written, or name another file.")
    if size > MOST_BYTES:
        raise UavrlError(
            f"{path} has {size / 1e9:.1f} GB, and at most {MOST_BYTES / 1e9:.1f} GB are read: decimate it, or cut it."
        )
    return path


def read_file(path: Path, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Points ``float64 [P, 3]`` and triangles ``[F, 3]`` as the file has them, read by another process.

    ``scale`` is its unit in metres, which tells the size of an opening that must stay one.
    """
    before = _settled(path)
    with tempfile.TemporaryDirectory(prefix="uavrl-") as folder:
        limits = [str(MOST_MEMORY), str(OPENING / scale**2)]
        command = [sys.executable, "-P", "-m", shape_reader.__name__, str(path), folder, *limits]
        paths = os.pathsep.join(each for each in sys.path if each)
        try:
            done = subprocess.run(
                command,
                env={**os.environ, "PYTHONPATH": paths},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise UavrlError(f"{path} was not read within {PATIENCE:.0f} s: decimate it, or cut it.") from None
        if done.returncode:
            reason = Path(folder) / "reason"
            raise _refused(path, reason.read_text(encoding="utf-8") if reason.is_file() else "memory")
        found = load_npy(Path(folder) / "points.npy"), load_npy(Path(folder) / "triangles.npy")
    if _stamp(path) != before:
        raise UavrlError(f"{path} has changed while it was read: wait until it is written.")
    return found


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns


def _settled(path: Path) -> tuple[int, int]:
    """The size and the time of a file that nobody writes any more."""
    before = _stamp(path)
    if abs(time.time() - before[1] / 1e9) < SETTLED:
        time.sleep(SETTLED / 4)
        if _stamp(path) != before:
            raise UavrlError(f"{path} is being written: wait until it is complete.")
    return before


def _refused(path: Path, reason: str) -> UavrlError:
    kind, _, text = reason.partition(" ")
    if kind == "missing":
        return MissingExtra(text.split(".")[0], "sim")
    if kind == "unread":
        return UavrlError(f"{path} {text}.")
    if kind == "memory":
        return UavrlError(
            f"{path} has {path.stat().st_size / 1e6:.1f} MB and unpacks to more than {MOST_MEMORY / 2**30:.0f} GB: "
            "decimate it, or, if it is not yours, do not trust it."
        )
    alone = ", as one file that refers to no others" if path.suffix.lower() == ".glb" else ""
    return UavrlError(
        f"{path} cannot be read as {path.suffix[1:].upper()} ({text}): if it is still being written, wait; otherwise "
        f"export it again{alone}."
    )


def to_metres(points: np.ndarray, path: Path, scale: float, up: Up) -> np.ndarray:
    """The points ``[P, 3]`` in metres with z up; refuses sizes that no place has, and warns of rounded coordinates."""
    turned = points[:, TURNED[up]] * scale
    extent = np.ptp(turned, axis=0)
    told = " × ".join(f"{length:,.0f}" if length >= 10 else f"{length:.2g}" for length in extent)
    if not extent.max() > 0:
        raise UavrlError(f"{path} has no extent: all of its points lie at one place. Name another file.")
    if extent.max() > LARGEST_EXTENT:
        most = np.ptp(np.percentile(turned, (1, 99), axis=0), axis=0)
        other = ", or remove points that lie far outside" if most.max() <= LARGEST_EXTENT else ""
        raise UavrlError(
            f"{path} is {told} m: if its unit is the millimetre, write env.world.scale={scale * 1e-3:g}{other}; at "
            f"most {LARGEST_EXTENT:,.0f} m are read."
        )
    if extent[:2].max() < LEAST_EXTENT:
        raise UavrlError(f"{path} is only {told} m: give the factor to metres by env.world.scale.")
    step = float(np.spacing(np.float32(np.abs(points).max()))) * scale
    if step > COARSE and (points.astype(np.float32) == points).all():
        log.warning(
            "%s has coordinates far from its origin as 32-bit floats, which rounds them to steps of %.2g m: export "
            "them as doubles, or move the origin near the site.",
            path,
            step,
        )
    return turned


def area_across(corners: np.ndarray) -> np.ndarray:
    """The area ``[3]`` of triangles ``[F, 3, 3]`` that is seen along each axis."""
    return np.asarray(np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).sum(0) / 2)


def columns_along(cells: np.ndarray) -> np.ndarray:
    """The number ``[3]`` of columns along each axis that hold any of the cells ``int [V, 3]``.

    Examples:
        >>> columns_along(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]])).tolist()
        [1, 3, 3]
    """
    return np.array([len(np.unique(np.delete(cells, axis, axis=1), axis=0)) for axis in range(3)])


def other_up(seen: np.ndarray, than: float, up: Up) -> Up | None:
    """The file's axis that seems to point up instead of ``up``, if any.

    Args:
        seen: How much is seen along each axis ``[3]``, the third of which is taken as up: most along the right one.
        than: More than twice this must be seen along another axis.
        up: The file's axis that is taken as up.

    Examples:
        The ground of a file whose z is up, which is read as if its y was:

        >>> other_up(np.array([1200.0, 10.0, 20.0]), 20.0, "y")
        'z'
    """
    best = int(seen.argmax())
    names: tuple[Up, ...] = ("x", "y", "z")
    return names[TURNED[up][best]] if best < 2 and seen[best] > 2 * than else None


def floor_of(surface: Surface) -> tuple[float, float]:
    """The heights of the floor and of the lowest surfaces; they differ in a solid, the ground of which is its top.

    Each is the median over columns. Whether a surface faces up tells a solid block of terrain, which has its base below
    the ground, from a room, which has its floor below the ceiling.
    """
    points, facing = surface
    lowest = _median_lowest(points)
    if facing is None or not _is_solid(points, facing):
        return lowest, lowest
    return _median_lowest(points[facing > FACES]), lowest


def _median_lowest(points: np.ndarray) -> float:
    """The median, over columns, of the lowest of the points ``[P, 3]`` in each."""
    column = np.floor(points[:, :2] / COLUMN).astype(np.int64)
    _, which = np.unique(column, axis=0, return_inverse=True)
    lowest = np.full(which.max() + 1, np.inf)
    np.minimum.at(lowest, which.ravel(), points[:, 2])
    return float(np.median(lowest))


def _is_solid(points: np.ndarray, facing: np.ndarray) -> bool:
    """Whether in most columns the lowest surface faces down and another one above it faces up.

    Empty columns count, too: pillars alone are no ground. Of a closed solid as much faces up as down, and of an open
    ground whose faces are turned under closed roofs does not.
    """
    if abs(facing.mean()) > OPEN * np.abs(facing).mean():
        return False
    flat, height = points[:, :2] - points[:, :2].min(0), points[:, 2]
    side = max(COLUMN, math.sqrt(SAMPLES * float(flat.max(0).prod()) / len(points)))
    cell = np.floor(flat / side).astype(np.int64)
    shape = tuple(cell.max(0) + 1)
    which, up = np.ravel_multi_index(tuple(cell.T), shape), facing > FACES
    lowest, highest, is_under = np.full(math.prod(shape), np.inf), np.full(math.prod(shape), -np.inf), np.zeros(shape)
    np.minimum.at(lowest, which, height)
    np.maximum.at(highest, which[up], height[up])
    is_under.ravel()[which[(height == lowest[which]) & (facing < -FACES)]] = 1
    return bool((is_under.ravel() * (highest > lowest)).mean() > 0.5)


def sampled(corners: np.ndarray, count: int = 200_000) -> Surface:
    """``count`` points spread evenly over the area of triangles ``[F, 3, 3]``, always the same ones."""
    rng = np.random.default_rng(0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    if not area.sum() > 0:
        return Surface(corners.reshape(-1, 3))
    which = rng.choice(len(corners), count, p=area / area.sum())
    share = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - share[0], share[0] * (1 - share[1]), share[0] * share[1]], -1)
    return Surface(np.einsum("ij,ijk->ik", weights, corners[which]), normal[which, 2] / area[which])
