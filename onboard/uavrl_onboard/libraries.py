"""Libraries of the extra ``deploy``, imported where they are needed."""

from importlib import import_module
from typing import Any

from uavrl_onboard.errors import UavrlError


def needed(module: str, what: str) -> Any:
    """A module of a library that ``what`` needs; one that is not installed is named."""
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError as error:
        raise UavrlError(f"{what} needs {library}, which is not installed: pip install {library}.") from error
