"""Run folders: made once, and removed again where nothing came of them."""

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from uavrl.errors import FolderTaken, UavrlError
from uavrl_onboard.files import numbered, why


@contextmanager
def made_folder(folder: Path, holding: str, *, another: bool = False) -> Iterator[Path]:
    """Makes a folder where there is none, and removes it where an error ends the block before it holds ``holding``.

    ``another`` makes one whose name ends in a number where there is one of this name; of several processes that ask in
    the same moment, each gets its own.
    """
    above: list[Path] = []
    try:
        above += [path for path in folder.parents if not path.exists()]
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder, is_new = _made(folder, another)
    except OSError as error:
        _remove_empty(above)
        raise UavrlError(
            f"The run folder {folder} cannot be written ({why(error, folder)}): choose another with run_dir=FOLDER."
        ) from error
    try:
        yield folder
    except FolderTaken:
        raise
    except Exception:
        if is_new and not any(folder.glob(holding)):
            shutil.rmtree(folder, ignore_errors=True)
            _remove_empty(above)
        raise


def _made(folder: Path, another: bool) -> tuple[Path, bool]:
    """The folder, and whether it was made here."""
    for made in numbered(folder, ""):
        try:
            made.mkdir()
            return made, True
        except FileExistsError:
            if not another:
                return folder, False
    raise AssertionError("there are numbers enough")


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
