"""A file of a user's: found, read safely, brought to metres with z up, or refused in a sentence."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np

from uavrl.envs import shape_reader
from uavrl.errors import MissingExtra, UavrlError

Up = Literal["x", "y", "z"]
MOST_BYTES = 2**30  # of a file
MOST_MEMORY = 8 * 2**30  # that reading may take
PATIENCE = 600.0  # s, for reading
SETTLED = 2.0  # s, since the last change of a file that nobody writes any more
LARGEST_EXTENT, LEAST_EXTENT = 5000.0, 3.0  # m


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


def read_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points ``float64 [P, 3]`` and triangles ``[F, 3]`` as the file has them, read by another process."""
    before = _settled(path)
    with tempfile.TemporaryDirectory(prefix="uavrl-") as folder:
        command = [sys.executable, "-P", "-m", shape_reader.__name__, str(path), folder, str(MOST_MEMORY)]
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
        found = np.load(Path(folder) / "points.npy"), np.load(Path(folder) / "triangles.npy")
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
    if kind == "memory":
        return UavrlError(
            f"{path} has {path.stat().st_size / 1e6:.1f} MB and unpacks to more than {MOST_MEMORY / 2**30:.0f} GB: "
            "decimate it, or, if it is not yours, do not trust it."
        )
    return UavrlError(
        f"{path} cannot be read as {path.suffix[1:].upper()} ({text}): if it is still being written, wait; otherwise "
        "export it again, as one file that refers to no others."
    )


def to_metres(points: np.ndarray, path: Path, scale: float, up: Up) -> np.ndarray:
    """The points ``[P, 3]`` in metres with z up; refuses sizes that no place has."""
    turned = {"x": points[:, [1, 2, 0]], "y": points[:, [2, 0, 1]], "z": points}[up] * scale
    extent = np.ptp(turned, axis=0)
    told = " × ".join(f"{length:,.0f}" if length >= 10 else f"{length:.2g}" for length in extent)
    if extent.max() > LARGEST_EXTENT:
        raise UavrlError(
            f"{path} is {told} m: if its unit is the millimetre, write env.world.scale={scale * 1e-3:g}; at most "
            f"{LARGEST_EXTENT:,.0f} m are read."
        )
    if extent[:2].max() < LEAST_EXTENT:
        raise UavrlError(f"{path} is only {told} m: give the factor to metres by env.world.scale.")
    return turned


def looks_y_up(corners: np.ndarray) -> bool:
    """Whether most of the surface of triangles ``[F, 3, 3]`` lies across y: the ground of a file whose y is up."""
    across = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).sum(0)
    return bool(across[1] > 2 * max(across[0], across[2]))


def floor_of(points: np.ndarray, side: float = 1.0) -> float:
    """The height of the floor under points of surfaces ``[P, 3]``: the median, over columns, of the lowest in each."""
    column = np.floor(points[:, :2] / side).astype(np.int64)
    _, which = np.unique(column, axis=0, return_inverse=True)
    lowest = np.full(which.max() + 1, np.inf)
    np.minimum.at(lowest, which.ravel(), points[:, 2])
    return float(np.median(lowest))


def sampled(corners: np.ndarray, count: int = 200_000) -> np.ndarray:
    """Points ``[count, 3]`` spread evenly over the area of triangles ``[F, 3, 3]``, always the same ones."""
    rng = np.random.default_rng(0)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.sum() > 0:
        return corners.reshape(-1, 3)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    share = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - share[0], share[0] * (1 - share[1]), share[0] * share[1]], -1)
    return np.einsum("ij,ijk->ik", weights, chosen)
