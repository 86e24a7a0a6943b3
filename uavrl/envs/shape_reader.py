"""Reads a mesh or a point cloud in a process of its own, which may use only so much memory.

A file from a stranger may claim to be huge, or refer to other files. Here no reader gets a resolver, materials are
left out, nothing is unpickled, and a file that unpacks to more than the limit ends this process and no other.

``python -m uavrl.envs.shape_reader FILE FOLDER BYTES`` writes ``points.npy`` and, for a mesh, ``triangles.npy`` into
the folder, or ``reason``.
"""

import sys
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

MESHES = (".stl", ".obj", ".ply", ".glb")
CLOUDS = (".ply", ".pcd", ".xyz", ".npy", ".npz")


def read_shape(path: Path, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Points ``[P, 3]`` and triangles ``[F, 3]`` of a file; a point cloud has no triangles."""
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return _points_of(_array(path, most)), np.zeros((0, 3), np.int64)
    with path.open("rb") as file:
        if suffix == ".pcd":
            from pypcd4 import PointCloud

            cloud = PointCloud.from_fileobj(file)
            return _points_of(cloud.numpy(("x", "y", "z"))), np.zeros((0, 3), np.int64)
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
    except Exception as error:  # whatever a reader raises for a damaged file
        text = " ".join(str(error).split()) or type(error).__name__
        (folder / "reason").write_text(f"damaged {text[:200]}", encoding="utf-8")
    else:
        return 0
    return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])))
