"""Every logger writes below the run folder, and a missing package is named in one sentence."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from omegaconf import DictConfig
from torchrl.checkpoint import Checkpoint

from tests.helpers.runs import small_config
from uavrl.runs.checkpoint import rotation
from uavrl.training.run import create_run, train

SETTINGS = ["logger.interval=1", "trainer.episodes=6", "algo.learning_starts=20"]


def train_and_write(config: DictConfig, *, resume: bool = False) -> None:
    """Trains, and waits for wandb's own process, which writes on after the end of a run."""
    train(config, Path(config.run_dir) if resume else create_run(config), resume=resume)
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


def test_tensorboard_shows_no_step_twice_over_a_resume(trained: Callable[[str], Path], tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    def shown(run: Path) -> dict[str, list[tuple[int, float]]]:
        accumulator = EventAccumulator(str(next((run / "logs").rglob("events.out.tfevents.*")).parent))
        accumulator.Reload()
        kept = (tag for tag in accumulator.Tags()["scalars"] if not tag.endswith("_seconds") and tag != "minutes")
        return {tag: [(event.step, event.value) for event in accumulator.Scalars(tag)] for tag in kept}

    whole = trained("tensorboard")
    cut = Path(shutil.copytree(whole, tmp_path / "run"))
    for later in rotation(cut).checkpoints()[2:]:
        later.unlink()
    at = Checkpoint.manifest(rotation(cut).latest())["metadata"]["collected_frames"]
    steps = [step for step, _ in shown(whole)["return"]]
    assert min(steps) < at < max(steps), "some of it stays, some of it is dropped and flown again"
    train(small_config(cut, "logger=tensorboard", *SETTINGS), cut, resume=True)
    assert len(list((cut / "logs").rglob("events.out.tfevents.*"))) > 1
    assert shown(cut) == shown(whole)


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


def test_wandb_shows_one_run_and_each_step_once_over_a_resume(
    trained: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("WANDB_CACHE_DIR", "WANDB_CONFIG_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "wandb-own"))
    whole = trained("wandb")
    cut = Path(shutil.copytree(whole, tmp_path / "run"))
    for later in rotation(cut).checkpoints()[1:]:
        later.unlink()  # as if the process had been killed before the second one
    ids, before = logged_to_wandb(cut)
    assert len(ids) == 1 and len(before["return"]) > 2
    longer = small_config(cut, "logger=wandb", *SETTINGS[:1], "trainer.episodes=8", *SETTINGS[2:])
    train_and_write(longer, resume=True)
    assert len(list((cut / "logs").glob("wandb/offline-run-*/run-*.wandb"))) == 2
    ids_after, after = logged_to_wandb(cut)
    assert ids_after == ids
    assert all(rows[: len(before[name])] == before[name] for name, rows in after.items() if name in before)
    assert len(after["return"]) == len(before["return"]) + 2
    for rows in after.values():
        steps = [step for step, _ in rows]
        assert steps == sorted(set(steps))


def test_a_run_with_another_logger_learns_the_same(trained: Callable[[str], Path]) -> None:
    runs = [trained("csv"), trained("tensorboard")]
    assert (runs[0] / "episodes.csv").read_bytes() == (runs[1] / "episodes.csv").read_bytes()
    assert all(rotation(run).latest() for run in runs)
