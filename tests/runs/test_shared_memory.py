"""What comes from shared memory is told from what comes from a disk."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from uavrl.runs.shared_memory import SharedMemoryError, hint_of_shared_memory, shared_memory_explained
from uavrl_onboard.cli.process import one_sentence

FULL = "No space left on device"


def raised_in(module: str, error: Exception) -> None:
    """Raises an error in a module of this name."""
    exec("def fail(error): raise error", names := {"__name__": module})
    names["fail"](error)


@pytest.mark.parametrize(
    ("module", "error"),
    [
        ("multiprocessing.synchronize", OSError(28, FULL)),
        ("multiprocessing.synchronize", OSError(38, "Function not implemented")),
        ("torch", RuntimeError(f"unable to allocate shared memory(shm) for file </torch_1_2_3>: {FULL} (28)")),
    ],
)
def test_an_error_of_shared_memory_names_it_and_the_remedy(
    module: str, error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SharedMemoryError, match=r"/dev/shm.*--shm-size"), shared_memory_explained():
        raised_in(module, error)
    with pytest.raises(SystemExit), one_sentence(), shared_memory_explained():
        raised_in(module, error)
    assert "--shm-size" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("module", "error"),
    [
        ("multiprocessing.synchronize", OSError(28, FULL, "episodes.csv")),
        ("uavrl_onboard.files", OSError(28, FULL)),
        ("torch", RuntimeError("mat1 and mat2 shapes cannot be multiplied")),
    ],
)
def test_other_errors_stay_what_they_are(module: str, error: Exception) -> None:
    with pytest.raises(type(error)) as caught, shared_memory_explained():
        raised_in(module, error)
    assert caught.value is error


@pytest.mark.parametrize(("total", "free", "told"), [(2**26, 2**25, True), (2**33, 2**19, True), (2**33, 2**30, False)])
def test_a_process_that_died_may_have_lacked_it(
    total: int, free: int, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def disk_usage(folder: Path) -> tuple[int, int, int]:
        assert folder == Path("/dev/shm")
        return total, total - free, free

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)
    assert ("--shm-size" in hint_of_shared_memory()) == told
