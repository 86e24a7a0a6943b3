"""Every logger writes below the run folder, and a missing package is named in one sentence."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig
from torchrl.checkpoint import Checkpoint, CheckpointRotation

from tests.helpers.runs import small_config
from uavrl.runs.checkpoint import rotation
from uavrl.training.run import create_run, resume_config, train

SETTINGS = ["logger.interval=1", "trainer.episodes=6", "algo.learning_starts=20"]


def train_and_write(config: DictConfig, run: Path | None = None, *, resume: bool = False) -> None:
    """Trains, and waits for wandb's own process, which writes on after the end of a run."""
    train(config, run or create_run(config), resume=resume)
    if "offline" in config.logger:
        importlib.import_module("wandb").teardown()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the folder of a run with a logger; each is trained once, in a working directory that must stay empty."""

    @cache
    def run_with(logger: str) -> Path:
        if logger != "csv":
            pytest.importorskip(logger)
        folder = tmp_path_factory.mktemp(logger)
        elsewhere = folder / "elsewhere"
        elsewhere.mkdir()
        config = small_config(folder / "run", f"logger={logger}", *SETTINGS)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(elsewhere)
            for name in ("WANDB_DIR", "WANDB_MODE", "WANDB_API_KEY"):
                patch.delenv(name, raising=False)
            for name in ("WANDB_CACHE_DIR", "WANDB_CONFIG_DIR", "WANDB_DATA_DIR"):
                patch.setenv(name, str(folder / "run/wandb-own"))
            train_and_write(config)
        assert not list(elsewhere.rglob("*"))
        assert {p.name for p in folder.iterdir()} == {"elsewhere", "run"}
        return folder / "run"

    return run_with


def test_tensorboard(trained: Callable[[str], Path]) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (events,) = (trained("tensorboard") / "logs").rglob("events.out.tfevents.*")
    accumulator = EventAccumulator(str(events.parent))
    accumulator.Reload()
    assert {"rate_arrived", "return", "loss_value"} <= {t.rpartition("/")[2] for t in accumulator.Tags()["scalars"]}


def in_tensorboard(run: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows of the one run below a run folder: values by name with their steps."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (folder,) = {path.parent for path in (run / "logs").rglob("events.out.tfevents.*")}
    accumulator = EventAccumulator(str(folder))
    accumulator.Reload()
    kept = (tag for tag in accumulator.Tags()["scalars"] if not tag.endswith("_seconds") and tag != "minutes")
    return {tag: [(event.step, event.value) for event in accumulator.Scalars(tag)] for tag in kept}


def killed_after(run: Path, checkpoints: int, folder: Path) -> Path:
    """A copy of a run as if its process had been killed before its next checkpoint."""
    cut = Path(shutil.copytree(run, folder))
    for later in rotation(cut).checkpoints()[checkpoints:]:
        later.unlink()
    return cut


@pytest.mark.parametrize("name", ["run", "renamed"])
def test_tensorboard_shows_one_run_and_no_step_twice_over_a_resume(
    name: str, trained: Callable[[str], Path], tmp_path: Path
) -> None:
    pytest.importorskip("tensorboard")
    whole = trained("tensorboard")
    cut = killed_after(whole, 2, tmp_path / name)
    at = Checkpoint.manifest(rotation(cut).latest())["metadata"]["collected_frames"]
    steps = [step for step, _ in in_tensorboard(whole)["return"]]
    assert min(steps) < at < max(steps), "some of it stays, some of it is dropped and flown again"
    resume(cut, "logger=tensorboard")
    assert len(list((cut / "logs").rglob("events.out.tfevents.*"))) > 1
    assert in_tensorboard(cut) == in_tensorboard(whole)


def test_a_renamed_run_goes_on_in_the_same_csv_files(trained: Callable[[str], Path], tmp_path: Path) -> None:
    whole = trained("csv")
    cut = killed_after(whole, 2, tmp_path / "renamed")
    resume(cut, "logger=csv")
    logged = [sorted((run / "logs").rglob("return.csv")) for run in (whole, cut)]
    assert [len(files) for files in logged] == [1, 1]
    assert logged[0][0].read_text() == logged[1][0].read_text()


def resume(run: Path, logger: str, *changed: str) -> None:
    """Goes on with a run as ``uavrl-train resume=RUN`` does."""
    overrides = small_config(run, logger, *SETTINGS, *changed)
    config = resume_config(run, overrides, [each.partition("=")[0] for each in ("run_dir=", *changed)])
    train_and_write(config, run, resume=True)


def test_tensorboard_has_written_all_before_a_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that is killed writes nothing more, and resumes behind its checkpoint."""
    pytest.importorskip("tensorboard")
    shown: list[dict[str, list[tuple[int, float]]]] = []
    save = CheckpointRotation.save

    def look(rotation: CheckpointRotation, *args: Any, **kwargs: Any) -> Path:
        shown.append(in_tensorboard(tmp_path / "run") if shown else {})  # the first comes before the first episode
        return save(rotation, *args, **kwargs)

    monkeypatch.setattr(CheckpointRotation, "save", look)
    config = small_config(tmp_path / "run", "logger=tensorboard", *SETTINGS)
    train(config, create_run(config))
    assert len(shown) > 2 and all(shown[2:])
    ends = [rows["return"][-1][0] for rows in shown[1:]]
    assert ends == [int(path.stem.rpartition("-")[2]) for path in rotation(tmp_path / "run").checkpoints()[1:]]


def test_wandb_offline(trained: Callable[[str], Path]) -> None:
    assert list((trained("wandb") / "logs").rglob("run-*.wandb"))


def logged_to_wandb(run: Path) -> tuple[set[str], dict[str, list[tuple[int, float]]]]:
    """The ids of wandb's runs below a run folder, and what was sent, in order: values by name with their steps."""
    from wandb.proto.wandb_internal_pb2 import Record

    ids: set[str] = set()
    values: dict[str, list[tuple[int, float]]] = {}
    for file in sorted((run / "logs").glob("wandb/offline-run-*/run-*.wandb"), key=lambda path: path.stat().st_mtime):
        for data in leveldb_records(file.read_bytes()):
            record = Record.FromString(data)
            if record.run.run_id:
                ids.add(record.run.run_id)
            row = {item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in record.history.item}
            for name in set(row) - {"step"} if "step" in row else ():
                values.setdefault(name, []).append((row["step"], row[name]))
    return ids, {name: rows for name, rows in values.items() if not name.startswith("_") and "seconds" not in name}


def leveldb_records(data: bytes) -> Iterator[bytes]:
    """The records of a log in LevelDB's format: blocks of 32 KiB, pieces with checksum, length and kind."""
    at, whole = 7, b""  # behind wandb's own header
    while at + 7 <= len(data):
        if 32768 - at % 32768 < 7:
            at += 32768 - at % 32768
            continue
        length, kind = int.from_bytes(data[at + 4 : at + 6], "little"), data[at + 6]
        whole += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # full, last
            yield whole
            whole = b""


def test_wandb_shows_one_run_and_each_step_once_however_often_it_is_killed(
    trained: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("WANDB_CACHE_DIR", "WANDB_CONFIG_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "wandb-own"))
    whole = trained("wandb")
    ids, expected = logged_to_wandb(whole)
    assert len(ids) == 1 and len(expected["return"]) > 3
    killed = killed_after(whole, 3, tmp_path / "killed")
    unwritten(killed)
    resume(killed, "logger=wandb")
    again = killed_after(killed, 2, tmp_path / "again")  # further back than what the first process had logged
    unwritten(again)
    resume(again, "logger=wandb")
    ids_after, after = logged_to_wandb(again)
    assert ids_after == ids
    assert without_times(after) == without_times(expected)
    longer = Path(shutil.copytree(again, tmp_path / "longer"))
    resume(longer, "logger=wandb", "trainer.episodes=8")
    _, after = logged_to_wandb(longer)
    assert len(list((longer / "logs").glob("wandb/offline-run-*/run-*.wandb"))) == 1
    assert len(after["return"]) == len(expected["return"]) + 2
    for name, rows in without_times(expected).items():
        assert after[name][: len(rows)] == rows


def unwritten(run: Path) -> None:
    """Leaves of wandb's files what is there when its process is killed soon: their header."""
    for file in (run / "logs").rglob("run-*.wandb"):
        file.write_bytes(file.read_bytes()[:7])


def without_times(values: dict[str, list[tuple[int, float]]]) -> dict[str, list[tuple[int, float]]]:
    return {name: rows for name, rows in values.items() if name != "minutes"}


def test_a_run_with_another_logger_learns_the_same(trained: Callable[[str], Path]) -> None:
    runs = [trained("csv"), trained("tensorboard")]
    assert (runs[0] / "episodes.csv").read_bytes() == (runs[1] / "episodes.csv").read_bytes()
    assert all(rotation(run).latest() for run in runs)
