"""Maps of valleys on disk: what takes a second to compute is kept for the next run.

A map is named after everything that it depends on: the rules of the world, the seed, and the code that computes it. So
an old map is never read by new code; it goes when the folder is full.
"""

import hashlib
import json
import logging
import os
import re
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

import uavrl_onboard
from uavrl.envs.array_file import load_npz
from uavrl.envs.lanes import Lane
from uavrl.runs.cache import FOLDER, MOST_BYTES, valley_folder

log = logging.getLogger(__name__)
_FORMAT = 2  # of a file
# The code that a map depends on, beside what it imports from NumPy and SciPy.
_CODE = ("lanes", "mesh", "obstacles", "place", "rules", "tasks", "terrain", "traps", "valley")
_ONBOARD = ("geometry", "mesh", "guards.map.grid")
# What reading a damaged archive raises: a flipped bit may say that it is encrypted, or that an array is huge.
_DAMAGED = (
    *(OSError, ValueError, KeyError, EOFError, IndexError, TypeError, RuntimeError, MemoryError),
    *(zipfile.BadZipFile, zlib.error),
)
_OURS = re.compile(r"[0-9a-f]{40}\.npz(\.\w+\.partial)?")
_MOST_ENTRY = 50_000_000  # bytes of one array: a damaged length must not fill the memory


class ValleyMap(NamedTuple):
    """What is computed of a valley.

    Attributes:
        candidates: ``[C, 2]``, where flights may begin and end, in m.
        lanes: of planes.
        trapped: start and goal of each trap's tasks as indices into ``candidates``, ``int [P, 2]`` each.
        fits: where on a grid at the flight level a vehicle fits and is free, ``bool [X, Y]``.
        corner: x and y of the grid's first point, in m.
    """

    candidates: np.ndarray
    lanes: list[Lane]
    trapped: list[np.ndarray]
    fits: np.ndarray
    corner: np.ndarray


def map_name(rules: Mapping[str, Any]) -> str:
    """The file name of the map of a valley with these rules, by the code of now."""
    text = json.dumps([_FORMAT, rules, CODE], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:40] + ".npz"


def _code() -> list[str]:
    """A hash of the code, and the versions of the libraries that it draws and computes with."""
    onboard = Path(uavrl_onboard.__path__[0])
    files = [Path(__file__).with_name(f"{name}.py") for name in _CODE]
    files += [onboard.joinpath(*name.split(".")).with_suffix(".py") for name in _ONBOARD]
    sources = hashlib.sha256(b"\0".join(file.read_bytes() for file in files))
    return [sources.hexdigest(), np.__version__, scipy.__version__]


CODE = _code()  # of the code that is imported now: its files may change while a run goes on


def is_kept(name: str) -> bool:
    """Whether there is a file of this name, damaged or not."""
    try:
        return (valley_folder() / name).is_file()
    except OSError:
        return False


def load_map(name: str) -> ValleyMap | None:
    """The map of this file name; None where there is none, or it is damaged, which is warned of."""
    path = valley_folder() / name
    try:
        found = _read(path)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return None
    except _DAMAGED as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        log.warning("%s is damaged (%s): its valley is built again.", path, reason)
        return None
    with suppress(OSError):
        os.utime(path)  # the least recently used go first
    return found


def _read(path: Path) -> ValleyMap:
    with path.open("rb") as file:
        _require_small(file)
        data = load_npz(file)
    candidates, lanes = data["candidates"], data["lanes"]
    trapped, traps = data["trapped"], data["traps"]
    fits, corner = data["fits"], data["corner"]
    valid = fits.ndim == 2 and fits.dtype == bool and fits.any() and corner.shape == (2,)
    valid = valid and corner.dtype == np.float64 and np.isfinite(corner).all()
    valid = valid and candidates.ndim == 2 and candidates.shape[1] == 2 and candidates.dtype == np.float64
    valid = valid and len(candidates) > 0
    valid = valid and lanes.ndim == 3 and lanes.shape[2] == 3 and lanes.dtype == np.float64
    valid = valid and trapped.ndim == 2 and trapped.shape[1] == 2 and trapped.dtype == np.int64
    valid = valid and traps.ndim == 1 and traps.dtype == np.int64 and (traps > 0).all() and traps.sum() == len(trapped)
    valid = valid and np.isfinite(candidates).all() and np.isfinite(lanes).all()
    if not valid or (trapped < 0).any() or (trapped >= len(candidates)).any():
        raise ValueError("its numbers are not those of a valley")
    parts = np.split(trapped, traps.cumsum()[:-1]) if len(traps) else []
    return ValleyMap(candidates, [Lane(corners) for corners in lanes], parts, fits, corner)


def _require_small(file: Any) -> None:
    with zipfile.ZipFile(file) as archive:
        if any(entry.file_size > _MOST_ENTRY for entry in archive.infolist()):
            raise ValueError("it is larger than a valley")
    file.seek(0)


def is_writable() -> bool:
    """Whether maps can be kept; says so where they cannot."""
    folder = valley_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError as error:
        _say_not_kept(str(folder), error.strerror or str(error))
        return False


def save_map(name: str, made: ValleyMap) -> None:
    """Keeps a map, whole or not at all; where it cannot be written, the next run computes it again."""
    folder = valley_folder()
    arrays = {
        "candidates": made.candidates.astype(np.float64),
        "lanes": np.stack([lane.corners for lane in made.lanes]) if made.lanes else np.zeros((0, 0, 3)),
        "trapped": np.concatenate([np.zeros((0, 2), np.int64), *made.trapped]).astype(np.int64),
        "traps": np.array([len(tasks) for tasks in made.trapped], np.int64),
        "fits": made.fits,
        "corner": made.corner,
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A name of its own: another run may write the same map at the same time.
        descriptor, partial = tempfile.mkstemp(dir=folder, prefix=f"{name}.", suffix=".partial")
        try:
            with os.fdopen(descriptor, "wb") as file:
                np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
            Path(partial).replace(folder / name)
        except BaseException:
            with suppress(OSError):
                Path(partial).unlink()
            raise
        _make_room(folder)
    except OSError as error:
        _say_not_kept(str(folder), error.strerror or str(error))


@lru_cache(maxsize=8)  # says it once
def _say_not_kept(folder: str, reason: str) -> None:
    log.info(
        "Built valleys cannot be kept in %s (%s): every run builds them again. Name another folder with %s.",
        folder,
        reason,
        FOLDER,
    )


def _make_room(folder: Path, most: int = MOST_BYTES) -> None:
    """Removes the least recently used maps until the others take at most so many bytes; other files stay."""
    found = []
    for path in (each for each in folder.iterdir() if _OURS.fullmatch(each.name)):
        with suppress(OSError):  # another run may have removed it
            status = path.lstat()
            found.append((status.st_mtime, status.st_size, path))
    left = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if left <= most:
            return
        with suppress(OSError):
            path.unlink()
            left -= size
