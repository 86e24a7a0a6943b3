"""Reads a mesh or a point cloud in a process of its own, which may use only so much memory.

A file from a stranger may claim to be huge, or refer to other files. Here no reader gets a resolver, materials are
left out, nothing is unpickled, and a file that unpacks to more than the limit ends this process and no other.

``python -m uavrl.envs.shape_reader FILE FOLDER BYTES`` writes ``points.npy`` and, for a mesh, ``triangles.npy`` into
the folder, or ``reason``.
"""

import json
import re
import struct
import sys
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from uavrl.envs.polygons import OPENING, count_filled, filled_in_obj, polygons_of_ply
from uavrl.envs.shape_text import Unread, plain_obj, plain_pcd, plain_ply, points_of_xyz

MESHES = (".stl", ".obj", ".ply", ".glb")
CLOUDS = (".ply", ".pcd", ".xyz", ".npy", ".npz")
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization")
LOOKS = ("KHR_materials_", "EXT_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")  # which change no surface
FAN = 6  # of the ways in which a GLB joins corners
MOST_COLUMNS = 32  # of an array of points: one with more is something else, as a depth image is
_RELATIVE = re.compile(rb"(?m)^f(?= )[^\n]*(?: -[0-9]| 0+(?![0-9]))")  # of an OBJ


def read_shape(path: Path, most: int, opening: float = OPENING) -> tuple[np.ndarray, np.ndarray]:
    """Points ``[P, 3]`` and triangles ``[F, 3]`` of a file; a point cloud has no triangles."""
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return _points_of_array(_array(path, most)), np.zeros((0, 3), np.int64)
    if suffix in (".pcd", ".xyz"):
        points = _points_of_pcd(path) if suffix == ".pcd" else points_of_xyz(path.read_bytes())
        return points, np.zeros((0, 3), np.int64)
    import trimesh

    with _opened(path, opening) as file:
        try:
            scene = trimesh.load_scene(
                file, file_type=suffix[1:], resolver={}, allow_remote=False, skip_materials=True, process=False
            )
        except UnboundLocalError as error:  # by trimesh, for a PLY in which it does not find them
            if suffix != ".ply":
                raise
            raise Unread(
                "calls the corners of its faces something other than vertex_indices: export it again"
            ) from error
        except ValueError as error:
            if "unexpected length" not in str(error):
                raise
            raise Unread(
                "is shorter or longer than its header tells: if it is still being written, wait. If its faces have "
                "different numbers of corners, triangulate it when you export it, or export it as ASCII"
            ) from error
        _require_faces((each for each in scene.geometry.values() if hasattr(each, "faces")), opening)
    if not any(isinstance(each, trimesh.Trimesh) and len(each.faces) for each in scene.geometry.values()):
        found = [each.vertices for each in scene.geometry.values() if hasattr(each, "vertices")]
        if not sum(map(len, found)):
            raise ValueError("it holds neither triangles nor points")
        return np.concatenate([np.zeros((0, 3)), *found]), np.zeros((0, 3), np.int64)
    mesh = scene.to_mesh()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def _opened(path: Path, opening: float) -> BinaryIO:
    """The file as trimesh reads it right; refuses those that it would read otherwise, or in part."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return BytesIO(plain_ply(path.read_bytes()))
    if suffix == ".obj":
        content = plain_obj(path.read_bytes())
        if _RELATIVE.search(content):
            raise Unread(
                "has faces with relative (negative) indices or an index 0, which are not read: export it with absolute "
                "ones, from 1 on"
            )
        file = BytesIO(content)
        _require_fans(filled_in_obj(file, opening))
        return file
    opened = path.open("rb")
    if suffix == ".glb":
        _require_plain(opened)
    return opened


def _points_of_pcd(path: Path) -> np.ndarray:
    from pydantic import ValidationError
    from pypcd4 import PointCloud

    try:
        cloud = PointCloud.from_fileobj(BytesIO(plain_pcd(path.read_bytes())))  # type: ignore[arg-type]
    except ValidationError as error:
        wrong = error.errors()[0]
        raise ValueError(f"the line {str(wrong['loc'][0]).upper()} of its header is wrong: {wrong['msg']}") from error
    held, told = np.size(cloud.pc_data), cloud.metadata.points
    if held < told:
        raise ValueError(f"it holds {held:,} of the {told:,} points that its header tells")
    return np.stack([np.asarray(cloud.pc_data[axis], np.float64) for axis in "xyz"], -1)


def _require_plain(file: BinaryIO) -> None:
    """Refuses a GLB with surfaces that trimesh reads otherwise, or leaves out."""
    start = file.read(20)
    try:
        magic, _, _, length, kind = struct.unpack("<4sIII4s", start)
        about = json.loads(file.read(length)) if (magic, kind) == (b"glTF", b"JSON") else {}
        needed = [str(name) for name in about.get("extensionsRequired", ())]
        parts = [part for mesh in about.get("meshes", ()) for part in mesh.get("primitives", ())]
        read = {index for part in parts for index in (part.get("attributes", {}).get("POSITION"), part.get("indices"))}
        sparse = any("sparse" in each for index, each in enumerate(about.get("accessors", ())) if index in read)
        fans = any(part.get("mode") == FAN for part in parts)
        weights = [each.get("weights", ()) for kind in ("meshes", "nodes") for each in about.get(kind, ())]
        moved = any(map(any, weights)) and any(part.get("targets") for part in parts)
    except (struct.error, ValueError, TypeError, AttributeError):
        return  # no GLB, which trimesh tells
    finally:
        file.seek(0)
    if names := [name for name in COMPRESSED if name in needed]:
        raise Unread(f"is compressed with {' and '.join(names)}, which is not read: export it without")
    if names := [name for name in needed if not name.startswith(LOOKS)]:
        raise Unread(f"needs {' and '.join(names)}, which is not read: export it without")
    if sparse or fans or moved:
        found = "sparse accessors" if sparse else "triangle fans" if fans else "morph targets"
        raise Unread(f"has {found}, which are not read: export it with plain triangles")


def _require_fans(filled: int) -> None:
    """Refuses faces that a fan of triangles would fill."""
    if filled:
        found = (
            "face with more than three corners that is"
            if filled == 1
            else "faces with more than three corners that are"
        )
        raise Unread(f"has {filled:,} {found} not convex, and would be filled: triangulate the mesh when you export it")


def _require_faces(geometry: Iterable[Any], opening: float) -> None:
    """Refuses a PLY whose faces trimesh reads otherwise."""
    for each in geometry:
        points, polygons, known = polygons_of_ply(each.metadata.get("_ply_raw", {}))
        if not known:
            raise Unread(
                "has faces with different numbers of corners, which are not read from a binary PLY: triangulate it "
                "when you export it, or export it as ASCII"
            )
        _require_fans(count_filled(points, polygons, opening))


def _array(path: Path, most: int) -> np.ndarray:
    """The array of an NPY file, or that of an NPZ file that holds points."""
    if path.suffix.lower() == ".npy":
        return np.asarray(np.load(path, allow_pickle=False, mmap_mode="r"))
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > most:
            raise MemoryError
    with np.load(path, allow_pickle=False) as data:
        names = [name for name in ("points", "xyz", "vertices") if name in data.files] or data.files
        if not names:
            raise Unread("holds no array: save the points as an array [P, 3]")
        if len(names) > 1 and names is data.files:
            raise Unread(f"holds the arrays {', '.join(data.files)}: save the one with the points as points")
        return np.asarray(data[names[0]])


def _points_of_array(array: np.ndarray) -> np.ndarray:
    """Points ``[P, 3]`` of an array of points, of an organised cloud ``[H, W, 3]``, or of fields x, y and z."""
    fields = {str(name).lower(): name for name in array.dtype.names or ()}
    if {"x", "y", "z"} <= set(fields):
        return np.stack([array[fields[axis]].ravel().astype(np.float64) for axis in "xyz"], -1)
    shape, kind = array.shape, array.dtype.kind
    is_cloud = (len(shape) == 2 and kind in "fiu") or (len(shape) == 3 and kind == "f")  # whole numbers: a picture
    found = f"holds an array of shape {list(shape)} and type {array.dtype}"
    if is_cloud and len(shape) == 2 and shape[0] in (3, 4) and shape[1] > 4:
        raise Unread(f"{found}, and points are [P, 3]: transpose it")
    if not is_cloud or not 3 <= shape[-1] <= MOST_COLUMNS:
        raise Unread(
            f"{found}, and points are numbers [P, 3] or [H, W, 3], with at most {MOST_COLUMNS} columns, or have fields "
            "x, y and z: save the points so"
        )
    return np.ascontiguousarray(array.reshape(-1, shape[-1])[:, :3], np.float64)


def limit_memory(most: int) -> None:
    """Lets this process take so many bytes, where the system can tell it so."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main(path: Path, folder: Path, most: int, opening: float) -> int:
    """Reads one file."""
    limit_memory(most)
    try:
        points, triangles = read_shape(path, most, opening)
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
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])))
