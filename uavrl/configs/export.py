"""Settings of ``uavrl-export``. Meanings stand in the yaml."""

from dataclasses import dataclass

from uavrl.configs.checks import require
from uavrl.ranges import Folder


@dataclass
class ExportConfig:
    """conf/export.yaml: one policy on its own."""

    packages: tuple[str, ...] = ()
    run: Folder | None = None
    policy: str | None = None
    checkpoint: Folder | None = None
    output: Folder | None = None

    def __post_init__(self) -> None:
        """Checks that there is a place to write to."""
        require(self.output is not None, "output", "a folder to write the policy to", self.output)
