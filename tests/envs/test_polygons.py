"""Faces with many corners are read as they are, or refused: no opening is filled, and nothing is left out."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from uavrl.envs.shape_file import read_file
from uavrl.envs.shape_reader import Unread, read_shape
from uavrl.errors import UavrlError

# A wall with a door, as one face: up, along the top, down, and around the opening.
WALL = [(0, 0), (4, 0), (4, 5), (6, 5), (6, 0), (10, 0), (10, 8), (0, 8)]
HEXAGON = [(2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2)]
CONCAVE = r"^has 1 face with more than three corners that is not convex, and would be filled: triangulate the mesh"


def obj(corners: list[Any], *faces: str) -> str:
    return "".join(f"v 0 {y} {z}\n" for y, z in corners) + "".join(f"f {face}\n" for face in faces)


def around(count: int, first: int = 0, join: str = " ") -> str:
    return join.join(str((first + corner) % count + 1) for corner in range(count))


def ply(corners: list[tuple[int, int]], faces: list[list[int]], *, binary: bool, name: str = "vertex_indices") -> bytes:
    kind = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {kind} 1.0\nelement vertex {len(corners)}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int {name}\nend_header\n"
    if binary:
        body = b"".join(struct.pack("<3f", 0, *corner) for corner in corners)
        return head.encode() + body + b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    text = "".join(f"0 {y} {z}\n" for y, z in corners)
    return (head + text + "".join(" ".join(map(str, (len(face), *face))) + "\n" for face in faces)).encode()


def read(path: Path, content: bytes | str) -> tuple[np.ndarray, np.ndarray]:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_shape(path, 2**30)


def area(found: tuple[np.ndarray, np.ndarray]) -> float:
    points, triangles = found
    return float(trimesh.Trimesh(points, triangles, process=False).area)


@pytest.mark.parametrize("first", range(8))
def test_a_wall_with_a_door_is_no_wall(first: int, tmp_path: Path) -> None:
    faces_first = obj([], around(8, first)) + obj(WALL)
    for content in (obj(WALL, around(8, first)), obj(WALL, around(8, first, " \\\n")), faces_first):
        with pytest.raises(Unread, match=CONCAVE):
            read(tmp_path / "wall.obj", content)
    face = [(first + corner) % 8 for corner in range(8)]
    for binary in (False, True):
        with pytest.raises(Unread, match=CONCAVE):
            read(tmp_path / "wall.ply", ply(WALL, [face], binary=binary))


@pytest.mark.parametrize("scale", [1.0, 0.001])
@pytest.mark.parametrize("first", range(8))
def test_so_is_a_door_in_a_long_wall(first: int, scale: float, tmp_path: Path) -> None:
    """Less than 1 % of the wall, in metres and in millimetres."""
    metres = [(0, 0), (19.5, 0), (19.5, 2), (20.5, 2), (20.5, 0), (40, 0), (40, 6), (0, 6)]
    wall = [(y / scale, z / scale) for y, z in metres]
    (tmp_path / "wall.obj").write_text(obj(wall, around(8, first)))
    with pytest.raises(UavrlError, match=r"wall\.obj has 1 face with more than three corners that is not convex"):
        read_file(tmp_path / "wall.obj", scale)


def test_a_tunnel_with_a_smooth_arch_stays_open(tmp_path: Path) -> None:
    angles = np.linspace(np.pi, 0, 360)
    arch = [(2 * np.cos(angle), 2 * np.sin(angle)) for angle in angles]
    mouth = [(-5, 0), *arch, (5, 0), (5, 6), (-5, 6)]
    with pytest.raises(Unread, match=CONCAVE):
        read(tmp_path / "a.obj", obj(mouth, around(len(mouth))))


def test_a_face_that_is_hardly_concave_is_read(tmp_path: Path) -> None:
    dented = [(0, 0), (1, 0.01), (2, 0), (2, 2), (0, 2)]
    for first in range(5):
        found = read(tmp_path / "a.obj", obj(dented, around(5, first)))
        assert area(found) == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize(
    ("corner", "face"),
    [("s t", ""), ("", "property list uchar float texcoord\n"), ("", "property uchar flags\n"), ("s t", "unused")],
    ids=["coordinates of corners", "coordinates of faces", "flags", "a corner of no face"],
)
def test_what_a_ply_tells_beside_its_corners_changes_nothing(corner: str, face: str, tmp_path: Path) -> None:
    """A grid of squares is read, and the wall with a door is not, however trimesh arranges the corners."""
    unused, face = face == "unused", face.replace("unused", "")
    size = 4
    grid = [(y, z) for z in range(size) for y in range(size)]
    squares = [[n, n + 1, n + 1 + size, n + size] for n in range(size * (size - 1)) if n % size < size - 1]

    def written(corners: list[Any], faces: list[list[int]]) -> str:
        corners = [(99, 99), *corners] if unused else corners
        faces = [[n + unused for n in each] for each in faces]
        head = f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n"
        head += "".join(f"property float {axis}\n" for axis in ("x y z " + corner).split())
        head += f"element face {len(faces)}\n" + (face if "flags" in face else "")
        head += "property list uchar int vertex_indices\n" + (face if "texcoord" in face else "") + "end_header\n"
        rows = [f"0 {y} {z}" + (f" {y / 9} {z / 9}" if corner else "") for y, z in corners]
        for each in faces:
            told = " ".join(map(str, (len(each), *each)))
            texture = f" {2 * len(each)} " + " ".join(f"{n / 9:.3f} 0" for n in each) if "texcoord" in face else ""
            rows.append(("7 " if "flags" in face else "") + told + texture)
        return head + "\n".join(rows) + "\n"

    assert area(read(tmp_path / "a.ply", written(grid, squares))) == pytest.approx((size - 1) ** 2)
    with pytest.raises(
        Unread, match="has 2 faces with more than three corners that are not convex, and would be filled"
    ):
        read(tmp_path / "a.ply", written(WALL, [list(range(8))] * 2))


def test_convex_faces_are_read_whole(tmp_path: Path) -> None:
    for number in range(6):
        assert area(read(tmp_path / "a.obj", obj(HEXAGON, around(6, number)))) == pytest.approx(12.0)
    slashed = obj(HEXAGON, "1/1/1 2/1/1 3/1/1 4/1/1 5/1/1 6/1/1") + "vt 0 0\nvn 1 0 0\n"
    assert area(read(tmp_path / "a.obj", slashed)) == pytest.approx(12.0)
    for binary in (False, True):
        assert area(read(tmp_path / "a.ply", ply(HEXAGON, [list(range(6))], binary=binary))) == pytest.approx(12.0)
    assert area(read(tmp_path / "a.ply", ply(HEXAGON, [[0, 1, 2, 3], [0, 3, 4], [0, 4, 5]], binary=False))) == 12.0


@pytest.mark.parametrize(
    ("faces", "told"),
    [
        ([[0, 1, 2, 3], [3, 4, 5], [0, 3, 5, 4, 1]], "has faces with different numbers of corners, which are not read"),
        (
            [[0, 1, 2, 3], [0, 3, 4], [0, 4, 5]],
            r"is shorter or longer than its header tells: .* If its faces have different numbers",
        ),
    ],
    ids=["as long as equal ones", "shorter"],
)
def test_a_binary_ply_with_different_faces_is_not_misread(faces: list[list[int]], told: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=told):
        read(tmp_path / "a.ply", ply(HEXAGON, faces, binary=True))


def glb(change: Any) -> bytes:
    content = trimesh.creation.box().export(file_type="glb")
    length = struct.unpack("<I", content[12:16])[0]
    about = json.loads(content[20 : 20 + length])
    change(about)
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def morphed(about: dict[str, Any], weight: float) -> None:
    mesh = about["meshes"][0]
    mesh["primitives"][0]["targets"] = [{"POSITION": mesh["primitives"][0]["attributes"]["POSITION"]}]
    mesh["weights"] = [weight]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda about: about.update(extensionsRequired=["EXT_mesh_gpu_instancing"]),
            "needs EXT_mesh_gpu_instancing, wh",
        ),
        (
            lambda about: about["accessors"][about["meshes"][0]["primitives"][0]["indices"]].update(sparse={}),
            "sparse acc",
        ),
        (lambda about: about["meshes"][0]["primitives"][0].update(mode=6), "has triangle fans, which are not read"),
        (lambda about: morphed(about, 0.5), "has morph targets, which are not read"),
    ],
)
def test_what_a_glb_needs_is_read_or_refused(change: Any, told: str, tmp_path: Path) -> None:
    with pytest.raises(Unread, match=told):
        read(tmp_path / "a.glb", glb(change))
    looks = glb(lambda about: about.update(extensionsRequired=["KHR_texture_transform", "KHR_materials_unlit"]))
    assert len(read(tmp_path / "a.glb", looks)[1]) == 12
    assert len(read(tmp_path / "a.glb", glb(lambda about: morphed(about, 0.0)))[1]) == 12, "at rest"


@pytest.mark.parametrize(
    ("binary", "told"),
    [
        (True, "^has 2 faces with more than three corners that are not convex"),
        (False, "something other than vertex_indices"),
    ],
)
def test_a_list_of_another_name_is_judged_as_well(binary: bool, told: str, tmp_path: Path) -> None:
    """trimesh takes the only list of a face in a binary file, whatever its name is."""
    with pytest.raises(Unread, match=told):
        read(tmp_path / "a.ply", ply(WALL, [list(range(8))] * 2, binary=binary, name="vertices"))


def test_an_npz_without_arrays_is_told(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz")
    with pytest.raises(ValueError, match="holds no array"):
        read_shape(tmp_path / "a.npz", 2**30)


def test_points_are_preferred_among_the_arrays_of_an_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", xyz=np.zeros((2, 3)), points=np.ones((3, 3)), colours=np.zeros((3, 3)))
    assert read_shape(tmp_path / "a.npz", 2**30)[0].tolist() == np.ones((3, 3)).tolist()
