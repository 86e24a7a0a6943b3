"""Reads a mesh or a point cloud in a process of its own, which may use only so much memory.

A file from a stranger may claim to be huge, or refer to other files. Here no reader gets a resolver, materials are
left out, nothing is unpickled, and a file that unpacks to more than the limit ends this process and no other.

``python -m uavrl.envs.shape_reader FILE FOLDER BYTES`` writes ``points.npy`` and, for a mesh, ``triangles.npy`` into
the folder, or ``reason``.
"""

import json
import mmap
import re
import struct
import sys
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

MESHES = (".stl", ".obj", ".ply", ".glb")
CLOUDS = (".ply", ".pcd", ".xyz", ".npy", ".npz")
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization")
_RELATIVE = re.compile(rb"[\r\n][ \t]*f(?=[ \t])[^\r\n#]*[ \t/]-[0-9]")  # a face of an OBJ


class Unread(ValueError):
    """A whole file that uses something that is not read: what, and what to do, as the rest of a sentence."""


def read_shape(path: Path, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Points ``[P, 3]`` and triangles ``[F, 3]`` of a file; a point cloud has no triangles."""
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return _points_of(_array(path, most)), np.zeros((0, 3), np.int64)
    with path.open("rb") as file:
        if suffix == ".pcd":
            from pypcd4 import PointCloud

            cloud = PointCloud.from_fileobj(file)
            held, told = np.size(cloud.pc_data), cloud.metadata.points
            if held < told:
                raise ValueError(f"it holds {held:,} of the {told:,} points that its header tells")
            return _points_of(cloud.numpy(("x", "y", "z"))), np.zeros((0, 3), np.int64)
        _require_absolute(file, suffix)
        _require_uncompressed(file, suffix)
        import trimesh

        if suffix == ".xyz":
            return _points_of(trimesh.exchange.xyz.load_xyz(file)["vertices"]), np.zeros((0, 3), np.int64)
        scene = trimesh.load_scene(
            file, file_type=suffix[1:], resolver={}, allow_remote=False, skip_materials=True, process=False
        )
    if not any(isinstance(each, trimesh.Trimesh) and len(each.faces) for each in scene.geometry.values()):
        found = [each.vertices for each in scene.geometry.values() if hasattr(each, "vertices")]
        if not sum(map(len, found)):
            raise ValueError("it holds neither triangles nor points")
        return _points_of(np.concatenate([np.zeros((0, 3)), *found])), np.zeros((0, 3), np.int64)
    mesh = scene.to_mesh()
    return _points_of(mesh.vertices), np.asarray(mesh.faces, np.int64)


def _require_absolute(file: BinaryIO, suffix: str) -> None:
    """Refuses an OBJ whose faces count corners backwards: trimesh takes other corners then."""
    if suffix != ".obj":
        return
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if _RELATIVE.search(content):
            raise Unread("has faces with relative (negative) indices, which are not read: export it with absolute ones")


def _require_uncompressed(file: BinaryIO, suffix: str) -> None:
    """Refuses a GLB whose corners are compressed: trimesh takes the bytes as they are."""
    if suffix != ".glb":
        return
    start = file.read(20)
    try:
        magic, _, _, length, kind = struct.unpack("<4sIII4s", start)
        about = json.loads(file.read(length)) if (magic, kind) == (b"glTF", b"JSON") else {}
        needed = about.get("extensionsRequired", ())
        names = [name for name in COMPRESSED if name in needed]
    except (struct.error, ValueError, TypeError, AttributeError):
        names = []  # no GLB, which trimesh tells
    file.seek(0)
    if names:
        raise Unread(f"is compressed with {' and '.join(names)}, which is not read: export it without")


def _array(path: Path, most: int) -> np.ndarray:
    """The array of an NPY file, or that of an NPZ file that holds points."""
    if path.suffix.lower() == ".npy":
        return np.asarray(np.load(path, allow_pickle=False, mmap_mode="r"))
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > most:
            raise MemoryError
    with np.load(path, allow_pickle=False) as data:
        names = [name for name in data.files if name in ("points", "xyz", "vertices")] or data.files
        if len(names) != 1:
            raise ValueError(f"holds the arrays {', '.join(data.files)}, of which none is called points")
        return np.asarray(data[names[0]])


def _points_of(array: Any) -> np.ndarray:
    found = np.asarray(array)
    if found.ndim != 2 or found.shape[1] < 3 or found.dtype.kind not in "fiu":
        raise ValueError(f"holds an array of shape {list(found.shape)} and type {found.dtype}, and points are [P, 3]")
    return np.ascontiguousarray(found[:, :3], np.float64)


def limit_memory(most: int) -> None:
    """Lets this process take so many bytes, where the system can tell it so."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main(path: Path, folder: Path, most: int) -> int:
    """Reads one file."""
    limit_memory(most)
    try:
        points, triangles = read_shape(path, most)
        np.save(folder / "points.npy", points)
        np.save(folder / "triangles.npy", triangles)
    except MemoryError:
        (folder / "reason").write_text("memory", encoding="utf-8")
    except ImportError as error:
        (folder / "reason").write_text(f"missing {error.name}", encoding="utf-8")
    except Unread as error:
        (folder / "reason").write_text(f"unread {error}", encoding="utf-8")
    except Exception as error:  # whatever a reader raises for a damaged file
        text = " ".join(str(error).split()) or type(error).__name__
        (folder / "reason").write_text(f"damaged {text[:200]}", encoding="utf-8")
    else:
        return 0
    return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])))
