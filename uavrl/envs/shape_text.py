"""Brings texts that programs write in different ways into the form that the libraries read.

Each function takes the content of a file and returns what trimesh or pypcd4 reads as it is meant, or refuses it.
"""

import re
from io import BytesIO, TextIOWrapper
from itertools import chain

import numpy as np

_PLY_HEAD = re.compile(rb"\s*end_header[ \t]*(?:\r\n|\r|\n|\Z)")
_PCD_HEAD = re.compile(rb"(?m)^DATA[ \t]+(\w+)[ \t\r]*(?:\n|\Z)")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


class Unread(ValueError):
    """A file whose content is not read: what, and what to do, as the rest of a sentence."""


def plain_obj(content: bytes) -> bytes:
    r"""An OBJ with plain lines, of faces that have the numbers of their corners only.

    Examples:
        >>> plain_obj(b" v 0 0 0\r\tf 1/1/1 2 \\\n3//1 # a wall\n")
        b'v 0 0 0\nf 1 2  3 \n'
    """
    content = re.sub(rb"#[^\n]*", b"", _with_line_feeds(content.removeprefix(_BYTE_ORDER_MARK)))
    content = content.replace(b"\\\n", b" ").replace(b"\t", b" ")
    return re.sub(rb"/[-0-9/]*", b"", re.sub(rb"\n +", b"\n", content.lstrip()))


def _with_line_feeds(content: bytes) -> bytes:
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def plain_ply(content: bytes) -> bytes:
    """A PLY with coordinates x, y and z; those of an ASCII file are read with all of their digits.

    Raises:
        Unread: If an ASCII file ends too early, or if there are triangle strips.
    """
    content = content.removeprefix(_BYTE_ORDER_MARK)
    end = _PLY_HEAD.search(content)
    if end is None:
        return content  # no PLY, which trimesh tells
    head, body = content[: end.start()], content[end.end() :]
    is_ascii = b"ascii" in b"".join(head.splitlines()[1:2]).lower()
    if is_ascii:
        head, body = _with_line_feeds(head), re.sub(rb"\n\s+", b"\n", _with_line_feeds(body).strip())
    counts = {name: int(count) for name, count in re.findall(rb"(?m)^element\s+(\S+)\s+(\d+)", head)}
    if counts.get(b"tristrips"):
        raise Unread("has triangle strips, which are not read: triangulate it when you export it")
    told, held = sum(counts.values()), body.count(b"\n") + bool(body)
    if is_ascii and held < told:
        raise Unread(
            f"holds {held:,} of the {told:,} lines that its header tells: if it is still being written, wait; "
            "otherwise export it again, with one line for each point and face"
        )
    head = re.sub(rb"(?m)^(property\s+\w+\s+)([XYZ])(?=\s*$)", lambda found: found[1] + found[2].lower(), head)
    if is_ascii:
        head = re.sub(rb"(?m)^property\s+float(?:32)?\s+([xyz])(?=\s*$)", rb"property double \1", head)
    return head + b"\nend_header\n" + body


def plain_pcd(content: bytes) -> bytes:
    """A PCD of the present version with fields x, y and z; those of an ASCII file are read with all of their digits.

    Raises:
        Unread: If there are no such fields.
        ValueError: If the header is not complete.
    """
    end = _PCD_HEAD.search(content)
    if end is None:
        raise ValueError("its header has no line DATA")
    rows = [line.split() for line in content[: end.start()].decode("utf-8", "replace").splitlines()]
    head = {row[0].upper(): row[1:] for row in rows if len(row) > 1}
    head.setdefault("FIELDS", head.get("COLUMNS", []))  # as the first versions call it
    if missing := [name for name in ("FIELDS", "SIZE", "TYPE") if not head.get(name)]:
        raise ValueError(f"its header has no line {' or '.join(missing)}")
    fields = [name.lower() if name in ("X", "Y", "Z") else name for name in head["FIELDS"]]
    if not {"x", "y", "z"} <= set(fields):
        raise Unread(f"has the fields {', '.join(fields)}, and points need x, y and z: export it with these")
    data, body, size = end[1].decode().lower(), content[end.end() :], head["SIZE"]
    if data == "ascii":
        size = ["8" if kind == "F" else given for kind, given in zip(head["TYPE"], size, strict=True)]
        body = re.sub(rb" ?\n ?", b"\n", re.sub(rb"[ \t\r]+", b" ", body))
    width = head.get("WIDTH", head.get("POINTS", ["0"]))[0]
    height = head.get("HEIGHT", ["1"])[0]
    lines = {
        "VERSION": ["0.7"],
        "FIELDS": fields,
        "SIZE": size,
        "TYPE": head["TYPE"],
        "COUNT": head.get("COUNT", ["1"] * len(fields)),
        "WIDTH": [width],
        "HEIGHT": [height],
        "POINTS": head.get("POINTS", [str(int(width) * int(height))]),
        "DATA": [data],
    }
    return "".join(f"{name} {' '.join(words)}\n" for name, words in lines.items()).encode() + body


def points_of_xyz(content: bytes) -> np.ndarray:
    r"""The points ``[P, 3]`` of lines of numbers, which blanks, commas or semicolons separate.

    Examples:
        >>> points_of_xyz(b"// X, Y, Z, intensity\n1.5, 2, 3, 99\n4, 5, 6, 99\n").tolist()
        [[1.5, 2.0, 3.0], [4.0, 5.0, 6.0]]
    """
    lines = TextIOWrapper(BytesIO(content), "utf-8-sig", errors="replace")
    comments = ("#", "//")
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith(comments)), "")
    delimiter = next((each for each in ";," if each in first), None)
    try:
        return np.loadtxt(chain([first], lines), comments=comments, delimiter=delimiter, usecols=(0, 1, 2), ndmin=2)
    except ValueError as error:
        told = str(error).partition(";")[0].rstrip(".")
        raise Unread(
            f"cannot be read as XYZ ({told}): each line must begin with x, y and z, as numbers with decimal points "
            "that blanks, commas or semicolons separate. Begin other lines with #"
        ) from error
