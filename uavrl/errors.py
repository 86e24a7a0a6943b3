"""Errors that a command prints as one sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from uavrl_onboard.errors import OtherFormat, Stopped, UavrlError, did_you_mean, reason, was_interrupted

__all__ = [
    "FlyingEnded",
    "FolderTaken",
    "MissingExtra",
    "OtherFormat",
    "Stopped",
    "UavrlError",
    "ValidationFailed",
    "did_you_mean",
    "extras",
    "missing_extra",
    "reason",
    "was_interrupted",
]


_EXTRAS = {  # the modules that each extra of uavrl brings
    "sim": ("pybullet", "embreex", "gymnasium"),
    "train": ("hydra", "tqdm", "filelock", "threadpoolctl", "sklearn", "kneed"),
    "video": ("av", "PIL"),
}


class MissingExtra(UavrlError, ImportError):
    """A module that an extra of uavrl brings is not installed.

    Examples:
        >>> print(MissingExtra("hydra", "train"))
        This part of uavrl needs hydra, which is not installed: pip install 'uavrl[train]'.
    """

    def __init__(self, module: str, extra: str) -> None:
        told = f"This part of uavrl needs {module}, which is not installed: pip install 'uavrl[{extra}]'."
        if extra == "sim":
            told += (
                " The simulator runs on Linux x86-64 and macOS arm64. Losses, transforms, models and buffers work "
                "without it."
            )
        super().__init__(told)


def missing_extra(error: BaseException) -> MissingExtra | None:
    """Return the error that names the extra to install, if a module of one could not be found."""
    module = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    return next((MissingExtra(module, extra) for extra, modules in _EXTRAS.items() if module in modules), None)


@contextmanager
def extras() -> Iterator[None]:
    """Turn a module that cannot be found into a :class:`MissingExtra`; for around imports of optional packages."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (missing := missing_extra(error)) is None:
            raise
        raise missing from error


class FolderTaken(UavrlError):
    """The folder is somebody else's: another process trains in it, or it holds something already. It stays as it is."""


class ValidationFailed(UavrlError):
    """The policy could not be evaluated while it trains; what the run has learned is safe."""


class FlyingEnded(UavrlError):
    """A process that flies has died: a run cannot go on, and what it has learned is safe."""

    def __init__(self, reason: object, how_to_go_on: str = "stopped.") -> None:
        self.reason = " ".join(str(reason).split())
        super().__init__(
            f"A process that flies has ended ({self.reason}); what it printed stands above. The run {how_to_go_on}"
        )
