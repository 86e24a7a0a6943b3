"""Texts are read as they are meant, however a program has written them, or refused: no point is lost or moved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from uavrl.envs.shape_reader import Unread, read_shape

CORNERS = np.array([(0, 0, 0), (10, 0, 0), (10, 6, 0), (0, 6, 4)], float)
FACES = [(0, 1, 2), (0, 2, 3)]
FAR = np.array([(500_000.019, 5_000_008.094, 0.246), (500_009.496, 5_000_024.398, 5.477), (500_003.1, 5_000_007.7, 1)])


def read(path: Path, content: str | bytes) -> tuple[np.ndarray, np.ndarray]:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_shape(path, 2**30)


def rows(points: np.ndarray, separator: str = " ") -> list[str]:
    return [separator.join(f"{value:.3f}" for value in point) for point in points]


def ply(points: np.ndarray, faces: Sequence[tuple[int, ...]], axes: str = "xyz", body: str | None = None) -> str:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in axes)
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n" if faces else ""
    lines = rows(points) + [" ".join(map(str, (len(face), *face))) for face in faces]
    return head + "end_header\n" + ("\n".join(lines) + "\n" if body is None else body)


def pcd(points: np.ndarray, *changes: tuple[str, str], kind: str = "ascii") -> bytes:
    head = "# .PCD\nVERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {kind}\n"
    for old, new in changes:
        assert old in head
        head = head.replace(old, new)
    body = "\n".join(rows(points)).encode() + b"\n" if kind == "ascii" else points.astype(np.float32).tobytes()
    return head.encode() + body


def obj(end: str = "\n", before: str = "", after: str = "") -> str:
    lines = [f"v {row}" for row in rows(CORNERS)]
    return before + end.join(lines + ["f {} {} {}".format(*np.add(face, 1)) + after for face in FACES]) + end


@pytest.mark.parametrize("faces", [[], FACES, [(0, 1, 2, 3), (0, 1, 2)]], ids=["points", "triangles", "mixed"])
def test_an_ascii_ply_that_is_cut_off_is_refused(faces: Sequence[tuple[int, ...]], tmp_path: Path) -> None:
    whole = ply(CORNERS, faces)
    held = read(tmp_path / "a.ply", whole)
    assert len(held[0]) == 4 and (len(held[1]) > 0) == bool(faces)
    head, _, body = whole.partition("end_header\n")
    lines = body.splitlines(keepends=True)
    for count in range(len(lines)):
        with pytest.raises(Unread, match=f"^holds {count} of the {len(lines)} lines that its header tells: if it is"):
            read(tmp_path / "a.ply", f"{head}end_header\n{''.join(lines[:count])}")


def test_a_ply_whose_points_share_a_line_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Unread, match=r"holds 1 of the 4 lines .* with one line for each point and face"):
        read(tmp_path / "a.ply", ply(CORNERS, [], body=" ".join(rows(CORNERS))))


@pytest.mark.parametrize("change", [("\n", "\r\n"), ("\n", "\r"), ("end_header\n", "end_header\n\n"), ("0 0", "0  0")])
def test_line_ends_and_blank_lines_of_a_ply_do_not_matter(change: tuple[str, str], tmp_path: Path) -> None:
    points, faces = read(tmp_path / "a.ply", ply(CORNERS, FACES).replace(*change))
    np.testing.assert_array_equal(points, CORNERS)
    assert faces.tolist() == [list(face) for face in FACES]


@pytest.mark.parametrize("axes", ["XYZ", "xyz"])
def test_a_ply_calls_its_axes_by_small_or_capital_letters(axes: str, tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(tmp_path / "a.ply", ply(CORNERS, FACES, axes))[0], CORNERS)
    binary = ply(CORNERS, [], axes, "").replace("ascii", "binary_little_endian").encode()
    np.testing.assert_array_equal(read(tmp_path / "a.ply", binary + CORNERS.astype("<f4").tobytes())[0], CORNERS)


def test_triangle_strips_are_refused(tmp_path: Path) -> None:
    strips = ply(CORNERS, [(0, 1, 2, 3)]).replace("element face", "element tristrips")
    with pytest.raises(Unread, match="has triangle strips, which are not read: triangulate it when you export it"):
        read(tmp_path / "a.ply", strips)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.xyz"])
def test_a_text_is_read_with_all_of_its_digits(name: str, tmp_path: Path) -> None:
    contents: dict[str, str | bytes] = {"a.ply": ply(FAR, []), "a.pcd": pcd(FAR), "a.xyz": "\n".join(rows(FAR))}
    np.testing.assert_allclose(read(tmp_path / name, contents[name])[0], FAR, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["ascii", "binary"])
@pytest.mark.parametrize(
    "changes",
    [
        [("VERSION .7", "VERSION .5"), ("VIEWPOINT 0 0 0 1 0 0 0\n", "")],
        [("VERSION .7", "VERSION .6"), ("COUNT 1 1 1\n", "")],
        [("VERSION .7\n", ""), ("FIELDS", "COLUMNS"), ("COUNT 1 1 1\n", ""), ("HEIGHT 1\n", "")],
        [("FIELDS x y z", "FIELDS X Y Z")],
        [("POINTS 4\n", "")],
        [("\n", "\r\n")],
    ],
)
def test_older_and_shorter_headers_of_a_pcd(changes: list[tuple[str, str]], kind: str, tmp_path: Path) -> None:
    points, triangles = read(tmp_path / "a.pcd", pcd(CORNERS, *changes, kind=kind))
    np.testing.assert_array_equal(points, CORNERS)
    assert not len(triangles)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("FIELDS x y z", "FIELDS u v w"), "has the fields u, v, w, and points need x, y and z: export it with these"),
        (("FIELDS x y z\n", ""), "its header has no line FIELDS"),
        (("TYPE F F F", "TYPE F F Q"), "the line TYPE of its header is wrong"),
        (("DATA ascii\n", ""), "its header has no line DATA"),
    ],
)
def test_a_pcd_whose_header_tells_no_points(change: tuple[str, str], told: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=told):
        read(tmp_path / "a.pcd", pcd(CORNERS, change))


@pytest.mark.parametrize(
    "text",
    [
        *("\n".join(rows(CORNERS, separator)) for separator in (" ", "\t", ",", ", ", ";", "; ")),
        "\ufeff" + "\n".join(rows(CORNERS)),
        "// X Y Z\n# by a scanner\n\n" + "\n".join(rows(CORNERS)),
        "\r".join(rows(CORNERS)),
        "".join(f"{row} 12 34 56{' 78' * number} # last\n" for number, row in enumerate(rows(CORNERS))),
    ],
)
def test_lines_of_numbers_are_points(text: str, tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(tmp_path / "a.xyz", text)[0], CORNERS)


@pytest.mark.parametrize(
    "text",
    [
        *("\n".join(rows(CORNERS, separator)).replace(".", ",") for separator in (" ", "\t", ";")),
        *("x y z\n1 2 3\n", "1 2\n3 4\n", "1 2 3\n4 5\n", "2\nH 1 2 3\nH 4 5 6\n"),
    ],
)
def test_an_xyz_file_is_told_how_its_lines_must_be(text: str, tmp_path: Path) -> None:
    with pytest.raises(
        Unread, match="each line must begin with x, y and z, as numbers with decimal points that blanks"
    ):
        read(tmp_path / "a.xyz", text)


@pytest.mark.parametrize(
    "text",
    [
        obj(before="\ufeff"),
        obj(end="\r"),
        obj(end="\r\n"),
        obj(after=" # a wall"),
        obj(before="# made by C:\\\n"),
        obj().replace("f ", "f\t"),
        obj().replace("\n", "\n  "),
        obj().replace("f 1 ", "f 1\\\n"),
        obj().replace("f 1 ", "f 1/1/1 "),
        obj().replace("3\nf", "3//1\nf"),
    ],
)
def test_any_way_to_write_an_obj_gives_its_triangles(text: str, tmp_path: Path) -> None:
    points, faces = read(tmp_path / "a.obj", text)
    np.testing.assert_array_equal(points, CORNERS)
    assert faces.tolist() == [list(face) for face in FACES]
