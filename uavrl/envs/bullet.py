"""PyBullet without the lines that its C code prints at import and at every connection."""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

from uavrl.errors import MissingSimulator


@contextmanager
def silenced() -> Iterator[None]:
    """Sends what C code prints to nowhere; Python's own output before and after is untouched."""
    if os.name != "posix":
        yield
        return
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for descriptor in (*kept, nowhere):
            os.close(descriptor)


with silenced():
    try:
        import pybullet
    except ModuleNotFoundError as error:
        raise MissingSimulator(error.name or "pybullet") from error

__all__ = ["pybullet", "silenced"]
