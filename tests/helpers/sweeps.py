"""Sweeps of trainings that are over in seconds."""

from __future__ import annotations

from pathlib import Path

from omegaconf import OmegaConf

from tests.helpers.commands import TINY, in_process
from uavrl.cli import train as train_command


def runs_in(folder: Path) -> dict[int, Path]:
    """The run folders below a folder by their seed."""
    return {int(OmegaConf.load(path).seed): path.parent for path in folder.glob("*/config.yaml")}


def sweep(folder: Path, *arguments: str) -> int:
    """A sweep below a folder, in this process."""
    return in_process(
        train_command.main, "-m", *TINY, f"run_dir={folder / 'run'}", f"hydra.sweep.dir={folder / 'sweep'}", *arguments
    )
