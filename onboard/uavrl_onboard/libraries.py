"""Libraries of the extras, imported only where they are needed."""

from importlib import import_module
from typing import Any

from uavrl_onboard.errors import UavrlError, was_interrupted


def needed(module: str, what: str, extra: str, otherwise: str = "") -> Any:
    """Import and return a module of an optional library.

    Args:
        module: its full name, such as ``"mcap.writer"``.
        what: the subject of the error, such as ``"A flight log"``.
        extra: of `uavrl-onboard`, which installs the library.
        otherwise: what else helps, at the end of the error.

    Raises:
        UavrlError: if the library is missing, or is installed and cannot be imported.

    Examples:
        >>> needed("nowhere.module", "A flight log", "log")
        Traceback (most recent call last):
        ...
        uavrl_onboard.errors.UavrlError: A flight log needs nowhere: pip install 'uavrl-onboard[log]'.
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except Exception as error:  # a wheel that was built for another NumPy also raises SystemError or AttributeError
        if was_interrupted(error):  # Ctrl-C while a compiled library loads comes out as its ImportError
            raise KeyboardInterrupt from error
        name = library.replace("_", "-")
        remedy = f"pip install 'uavrl-onboard[{extra}]'{otherwise}."
        if isinstance(error, ModuleNotFoundError) and (error.name or library).partition(".")[0] == library:
            raise UavrlError(f"{what} needs {name}: {remedy}") from error
        reason = " ".join(str(error).split())[:200]
        raise UavrlError(f"{what} needs {name}, which cannot be imported ({reason}): {remedy}") from error
