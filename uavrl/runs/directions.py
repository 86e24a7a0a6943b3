"""The directions of a LiDAR of one's own: a run keeps a copy of their file, so that it can be moved and shared."""

import hashlib
import shutil
from contextlib import suppress
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from uavrl.runs.names import DIRECTIONS

KEY = "perception.lidar.sensor.directions"


def keep_directions(config: DictConfig, run_dir: Path) -> None:
    """Copy the file that a configuration names into the run folder, and name the copy instead."""
    original = _named(config)
    if original is not None and original.parent.resolve() != run_dir.resolve():
        shutil.copyfile(original, _copy(original, run_dir))
    use_kept_directions(config, run_dir)


def use_kept_directions(config: DictConfig, run_dir: Path) -> None:
    """Let the configuration of a run name the copy in its folder, wherever that is now."""
    original = _named(config)
    if original is not None and (kept := _copy(original, run_dir)).is_file():
        OmegaConf.update(config, KEY, str(kept.resolve()))


def by_content(config: DictConfig) -> None:
    """Let a configuration hold a hash of the directions instead of the name of their file, if it can be read."""
    if (file := _named(config)) is not None:
        with suppress(OSError):
            OmegaConf.update(config, KEY, hashlib.sha256(file.read_bytes()).hexdigest())


def _copy(original: Path, run_dir: Path) -> Path:
    """Where a run keeps such a file."""
    return run_dir / next((name for name in DIRECTIONS if Path(name).suffix == original.suffix), DIRECTIONS[0])


def _named(config: DictConfig) -> Path | None:
    """The file that a configuration names, if it does."""
    sensor = OmegaConf.select(config, KEY.rpartition(".")[0])
    found = sensor.get("directions") if isinstance(sensor, DictConfig) else None
    return Path(found) if isinstance(found, str) else None
