"""What becomes of files on a bad disk."""

from __future__ import annotations

from pathlib import Path


def flip(path: Path, position: int) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 0xFF
    path.write_bytes(bytes(data))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def halve(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip_in_the_middle(path: Path) -> None:
    flip(path, path.stat().st_size // 2)


def flip_in_the_networks(path: Path) -> None:
    flip(path, path.read_bytes().index(b"loss_module/state/tensor_00000012.memmap") + 3000)


def flip_in_the_directory(path: Path) -> None:
    flip(path, path.read_bytes().rindex(b"PK\x01\x02") + 1)
