"""Memory of arrays that one cycle frees, for those of the next one."""

from __future__ import annotations

import numpy as np

KEPT = 2**25 - 2**16  # bytes: glibc's largest threshold is 32 MiB, with what it adds to an array


def keep_memory() -> None:
    """Let the C library keep freed memory instead of giving it back to the system after each array.

    A scan makes arrays of some hundred KiB. glibc takes memory for such arrays from the system and gives it back at
    once, so that each array of each cycle costs dozens of page faults. It does so only above a threshold, which rises
    to the size of the largest array that was freed (``M_MMAP_THRESHOLD`` in mallopt(3)). With other C libraries nothing
    changes.
    """
    np.empty(KEPT, np.uint8)
