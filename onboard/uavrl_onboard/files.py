"""Files that are whole or not there, and files of others that may lie about their lengths."""

import errno
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from uavrl_onboard.errors import UavrlError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a file beside ``path`` to write to, which takes its place once it is whole.

    It is of this call alone, so that two programs that write the same file do not write into each other's. Only a
    program that is killed leaves it behind, as ``NAME.….partial``.
    """
    partial = _partial(path)
    try:
        with naming(path):
            yield partial
            partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _partial(path: Path) -> Path:
    """A new, empty file beside another one, which nobody else has."""
    while True:
        partial = path.with_name(f"{path.name}.{secrets.token_hex(3)}.partial")
        with suppress(FileExistsError):
            partial.touch(exist_ok=False)
            return partial


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Gives an error of the disk the path that it came from: a write to an open file does not tell it."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def writable(path: Path, option: str = "output=FILE") -> Path:
    """The path itself, found writable before anything is computed for it; its folder is made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        # Root would put a file in the place of /dev/null, or of the link /dev/stdout, for all programs.
        if path.exists() and (not path.is_file() or path.absolute().parent == Path("/dev")):
            raise OSError(errno.EINVAL, "it is a device or a pipe, not a file")
        _partial(path).unlink()
    except OSError as error:
        raise UavrlError(f"{path} cannot be written ({why(error, path)}): choose another with {option}.") from error
    return path


def why(error: OSError, path: Path) -> str | None:
    """What the system says, but for a file among the folders of a path, of which it says "File exists"."""
    if not isinstance(error, FileExistsError | NotADirectoryError):  # others may also come of looking at these folders
        return error.strerror
    files = [above for above in path.parents if above.exists() and not above.is_dir()]
    return f"{files[0]} is no folder" if files else error.strerror


def require_room(folder: Path, size: float) -> None:
    """Refuses to write more than the disk has left: what is mapped into memory dies of a full disk without an error."""
    free = shutil.disk_usage(folder).free
    if free < size:
        wanted = f"{size / 1e6:,.1f} MB are needed and {free / 1e6:,.1f} MB are left"
        raise OSError(errno.ENOSPC, wanted, str(folder))


def new_file(path: Path) -> BinaryIO:
    """Opens a file to write to, which nobody else has: where there is one of this name, its name ends in a number."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for free in numbered(path, path.suffix):
        with suppress(FileExistsError):
            return free.open("xb")
    raise AssertionError("there are numbers enough")


def numbered(path: Path, suffix: str) -> Iterator[Path]:
    """The path itself, and then with a number before its suffix."""
    yield path
    stem = path.name.removesuffix(suffix)
    yield from (path.with_name(f"{stem}_{number}{suffix}") for number in count(2))


class RecordFile:
    """A file that a library reads record by record, where none may take more than its share of memory.

    The libraries trust the lengths in a file: they allocate what it says, or read to its end for a negative length.

    Args:
        file: the file, open for reading.
        most: bytes of one record.

    Examples:
        >>> from io import BytesIO
        >>> file = RecordFile(BytesIO(bytes(8)), most=6)
        >>> len(file.read(6)), file.next_record()
        (6, None)
        >>> file.read(3)
        Traceback (most recent call last):
        ...
        EOFError: the file ends within a record
    """

    def __init__(self, file: BinaryIO, most: int) -> None:
        self._file, self._most, self._left = file, most, most

    def next_record(self) -> None:
        """Begin another record."""
        self._left = self._most

    def read(self, size: int) -> bytes:
        """Read exactly so many bytes.

        Raises:
            ValueError: for a negative size, and for more than the record may still have.
            EOFError: if the file has fewer.
        """
        if not 0 <= size <= self._left:
            raise ValueError(f"a length of {size} bytes")
        self._left -= size
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("the file ends within a record")
        return data
