"""Errors that a command prints as one sentence."""

from uavrl_onboard.errors import OtherFormat, Stopped, UavrlError, did_you_mean, reason, was_interrupted

__all__ = [
    "FlyingEnded",
    "FolderTaken",
    "MissingSimulator",
    "OtherFormat",
    "Stopped",
    "UavrlError",
    "did_you_mean",
    "reason",
    "was_interrupted",
]


class MissingSimulator(UavrlError, ImportError):
    """The simulator has no wheels for this machine, or was not installed."""

    def __init__(self, module: str) -> None:
        super().__init__(
            f"uavrl's simulator needs {module}, which is not installed: it runs on Linux x86-64 and macOS arm64, where "
            "`pip install uavrl` brings it. Losses, transforms, models and buffers work without it."
        )


class FolderTaken(UavrlError):
    """The folder is somebody else's: another process trains in it, or it holds something already. It stays as it is."""


class FlyingEnded(UavrlError):
    """A process that flies has died: a run cannot go on, and what it has learned is safe."""

    def __init__(self, reason: object, how_to_go_on: str = "stopped.") -> None:
        self.reason = " ".join(str(reason).split())
        super().__init__(
            f"A process that flies has ended ({self.reason}); what it printed stands above. The run {how_to_go_on}"
        )
