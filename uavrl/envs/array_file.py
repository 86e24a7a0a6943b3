"""Reads NumPy's files, in one thread at a time.

NumPy reads the header of an array by :mod:`ast`, and CPython counts how deep that is for all threads together: two that
read at once may end in "SystemError: AST constructor recursion depth mismatch" (python/cpython#106905).
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from uavrl.locks import OneAtATime

_ONE_AT_A_TIME = OneAtATime()


def load_npy(file: Path | BinaryIO) -> np.ndarray:
    """The array of an NPY file.

    Raises:
        ValueError: for an NPZ file of this name.
    """
    with _ONE_AT_A_TIME:
        found = np.load(file, allow_pickle=False)
        if not isinstance(found, np.ndarray):
            found.close()
            raise ValueError("it is an NPZ file by its content")
        return found


def load_npz(file: Path | BinaryIO) -> dict[str, np.ndarray]:
    """All arrays of an NPZ file."""
    with _ONE_AT_A_TIME, np.load(file, allow_pickle=False) as data:
        return dict(data)
