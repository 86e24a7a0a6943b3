"""What became of a sweep's runs, in the process of its command, whichever process a launcher trained them in."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.singleton import Singleton
from hydra.errors import HydraException

from uavrl.errors import UavrlError


class _Known(metaclass=Singleton):
    """What this process knows; a singleton of Hydra's, of which a launcher hands a copy to each process it starts.

    So a run that has ended is told once, also where the sweep waits for others and is launched again.
    """

    def __init__(self) -> None:
        # Of each run: its place in the sweep, and whether it has ended.
        self.by_place: dict[Path, tuple[int, bool]] = {}
        self.twice: set[Path] = set()  # runs of two combinations, each of which another process trained
        self.swept: list[str] = []  # the keys with several values


class Outcome:
    """What a run's process gives back of it; it is noted where it is made, and again where it is unpickled.

    Hydra's launchers hand it on to the process of the command, and Hydra then drops it.
    """

    def __init__(self, run_dir: Path, place: int, ended: bool) -> None:
        self._about = run_dir, place, ended
        if has_another_place(run_dir, place):
            _Known().twice.add(run_dir)
        if not was_ended(run_dir):
            _Known().by_place[run_dir] = place, ended

    def __reduce__(self) -> tuple[Any, ...]:
        """Made anew, so that it is noted there, too."""
        return Outcome, self._about


def forget() -> None:
    """Begins a sweep."""
    _Known().by_place.clear()
    _Known().twice.clear()
    _Known().swept.clear()


def note_swept(overrides: Iterable[str]) -> None:
    """Notes which keys of a command line have several values."""
    _Known().swept += [key for key in map(_swept_key, overrides) if key is not None]


def differences(overrides: Iterable[str], params: Mapping[str, Any]) -> dict[str, str]:
    """The values of the keys that a sweep varies.

    Args:
        overrides: those of one combination.
        params: the sweeper's own, which an experiment sets.
    """
    ours = {key for key in (_swept_key(f"{key}={value}") for key, value in params.items()) if key is not None}
    values = dict(override.lstrip("+~").partition("=")[::2] for override in overrides)
    return {key: value for key, value in values.items() if key in ours or key in _Known().swept}


def _swept_key(override: str) -> str | None:
    """The key of an override with several values, else None."""
    try:
        parsed = OverridesParser.create().parse_override(override)
    except HydraException:  # a text, or an option
        return None
    return str(parsed.key_or_group) if parsed.is_sweep_override() else None


def was_ended(run_dir: Path) -> bool:
    """Whether a run has ended, by what this process knows."""
    return _Known().by_place.get(run_dir, (0, False))[1]


def has_another_place(run_dir: Path, place: int) -> bool:
    """Whether an earlier combination of the sweep has this folder."""
    return _Known().by_place.get(run_dir, (place, False))[0] != place


def same_run(run_dir: Path) -> UavrlError:
    """What is said of two combinations that have one folder."""
    return UavrlError(
        f"Two combinations of the sweep have the same run folder {run_dir}, because their differences do not affect "
        f"learning, or are in no part of its name: give each its own run_dir."
    )


def refuse_twice() -> None:
    """Tells of one where a launcher's processes each knew of one of the two."""
    if twice := _Known().twice:
        raise same_run(min(twice))


def runs(*, ended: bool) -> list[Path]:
    """Those that have ended, or those that other processes train, in the sweep's order."""
    return [run for run, (_, has) in sorted(_Known().by_place.items(), key=lambda item: item[1][0]) if has is ended]
