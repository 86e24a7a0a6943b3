"""Where this machine keeps what would else be computed again in each run."""

import os
from pathlib import Path

FOLDER = "UAVRL_CACHE"  # environment variable that names the folder
MOST_BYTES = 100_000_000  # of built valleys


def cache_folder() -> Path:
    """The folder: ``$UAVRL_CACHE``, or else ``uavrl`` where the XDG specification puts caches.

    Examples:
        >>> cache_folder().is_absolute()
        True
    """
    if own := os.environ.get(FOLDER):
        return Path(own).absolute()
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else _home() / ".cache") / "uavrl"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # a user whom the system does not know
        return Path("/nonexistent")


def valley_folder() -> Path:
    """The folder of built valleys."""
    return cache_folder() / "valleys"
