"""The directions of a LiDAR of one's own: a run keeps a copy of their file, so that it can be moved and shared."""

import copy
import filecmp
import hashlib
import logging
import shutil
from contextlib import suppress
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from uavrl.errors import UavrlError
from uavrl.runs.names import DIRECTIONS
from uavrl_onboard.files import replacing

KEY = "perception.lidar.sensor.directions"
_MOST_BYTES = 2**28  # of a file of directions

log = logging.getLogger(__name__)


def keep_directions(config: DictConfig, folder: Path) -> None:
    """Copy the file that a configuration names into the folder of a run or a policy, and name the copy instead."""
    original = _named(config)
    if original is None:
        return
    kept = _copy_of(original, folder)
    if original.resolve() != kept.resolve():
        if not original.is_file():
            raise UavrlError(f"The directions of the LiDAR, {original}, are no longer there: put the file back.")
        if kept.exists() and not filecmp.cmp(original, kept, shallow=False):
            raise UavrlError(
                f"{kept} would be overwritten by the directions of the LiDAR, {original}: choose another folder, or "
                f"move that file."
            )
        with replacing(kept) as partial:
            shutil.copyfile(original, partial)
        log.info("The directions of the LiDAR, %s, are copied to %s.", original, kept)
    OmegaConf.update(config, KEY, str(kept.resolve()))


def use_kept_directions(config: DictConfig, folder: Path) -> None:
    """Let the configuration of a run or a policy name the copy in its folder, wherever that is now."""
    original = _named(config)
    if original is None:
        return
    kept = _copy_of(original, folder)
    if kept.is_file() or original.name == str(original):  # a name alone is that of the copy, and of nothing elsewhere
        OmegaConf.update(config, KEY, str(kept.absolute()))


def with_name_alone(config: DictConfig) -> DictConfig:
    """The configuration as its folder holds it: the copy has no path, which would say where the folder was made."""
    kept = _named(config)
    if kept is None or kept.name not in DIRECTIONS:
        return config
    written = copy.deepcopy(config)
    OmegaConf.update(written, KEY, kept.name)
    return written


def by_content(config: DictConfig) -> None:
    """Let a configuration hold a hash of the directions instead of the name of their file, if it can be read."""
    if (file := _named(config)) is not None:
        with suppress(OSError, ValueError):
            if file.is_file() and file.stat().st_size <= _MOST_BYTES:
                OmegaConf.update(config, KEY, hashlib.sha256(file.read_bytes()).hexdigest())


def _copy_of(original: Path, folder: Path) -> Path:
    """Where a folder keeps such a file."""
    suffix = original.suffix.lower()
    return folder / next((name for name in DIRECTIONS if Path(name).suffix == suffix), DIRECTIONS[0])


def _named(config: DictConfig) -> Path | None:
    """The file that a configuration names, if it does."""
    sensor = OmegaConf.select(config, KEY.rpartition(".")[0])
    found = sensor.get("directions") if isinstance(sensor, DictConfig) else None
    return Path(found) if isinstance(found, str) else None
