"""What takes long to make and is only looked at is made once, for all tests and workers, while the sources stay."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

from filelock import FileLock

from tests.helpers.commands import in_process
from uavrl.cli import train as train_command
from uavrl.envs.place import Place
from uavrl.runs.provenance import processor, versions

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / ".pytest_cache/d/kept"
DAY = 86_400


@cache
def _folder() -> Path:
    """What is kept of these sources, of this commit and with these packages; what is older than a day is removed."""
    kernels = {key: os.environ.get(key) for key in ("MKL_CBWR", "OPENBLAS_CORETYPE", "ATEN_CPU_CAPABILITY")}
    packages = {name: version(name) for name in ("tensordict", "scipy", "hydra-core")}
    digest = hashlib.sha256(repr((versions(), packages, processor(), kernels)).encode())
    sources = (path for name in ("uavrl", "conf", "examples") for path in (ROOT / name).rglob("*"))
    for path in sorted(path for path in sources if path.suffix in (".py", ".yaml")):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    folder = KEPT / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    for other in KEPT.iterdir():
        with suppress(FileNotFoundError):  # another worker removes it too
            if other != folder and time.time() - other.stat().st_mtime > DAY:
                shutil.rmtree(other, ignore_errors=True)
    return folder


@contextmanager
def _kept(name: str) -> Iterator[tuple[Path, bool]]:
    """The place of what has a name, and whether it is there; one process at a time makes it."""
    place = _folder() / hashlib.sha256(name.encode()).hexdigest()[:16]
    done = place / "done"
    with FileLock(f"{place}.lock", timeout=600):
        if not done.exists():
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
        yield place, done.exists()
        done.touch()


def finished_run(copy: Path, *overrides: str) -> Path:
    """Copies a run that was trained with these overrides to ``copy``, which the caller may change."""
    with _kept(repr(overrides)) as (place, there):
        assert there or in_process(train_command.main, *overrides, f"run_dir={place / 'run'}") == 0
    return Path(shutil.copytree(place / "run", copy))


def built_valley(name: str, build: Callable[[], Place]) -> Place:
    """A valley as it was built when it was first asked for by this name."""
    with _kept(name) as (place, there):
        if not there:
            (place / "valley").write_bytes(pickle.dumps(build()))
        valley: Place = pickle.loads((place / "valley").read_bytes())
    return valley
