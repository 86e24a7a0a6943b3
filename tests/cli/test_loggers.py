"""Every logger writes below the run folder, and a missing package is named in one sentence."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from torchrl.checkpoint import Checkpoint

from tests.training.test_resume import small_config
from uavrl.errors import UavrlError
from uavrl.training.checkpoint import rotation
from uavrl.training.run import create_run, train

SETTINGS = ["logger.interval=1", "trainer.episodes=6", "algo.random_steps=20"]


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
            train(config, create_run(config))
        assert not list(elsewhere.rglob("*"))
        assert {p.name for p in folder.iterdir()} == {"elsewhere", "run"}
        return folder / "run"

    return run_with


def test_csv(trained: Callable[[str], Path]) -> None:
    logs = trained("csv") / "logs"
    names = {p.stem for p in logs.rglob("*.csv")}
    assert {"rate_arrived", "rate_collided", "rate_timed_out", "return", "episodes"} <= names
    (episodes,) = logs.rglob("episodes.csv")
    assert [float(line.split(",")[-1]) for line in episodes.read_text().splitlines()][-1] == 6.0


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
        kept = (tag for tag in accumulator.Tags()["scalars"] if not tag.endswith("_seconds"))
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


def test_a_run_with_another_logger_learns_the_same(trained: Callable[[str], Path]) -> None:
    runs = [trained("csv"), trained("tensorboard")]
    assert (runs[0] / "episodes.csv").read_bytes() == (runs[1] / "episodes.csv").read_bytes()
    assert all(rotation(run).latest() for run in runs)


@pytest.mark.parametrize(("name", "flag"), [("tensorboard", "_has_tb"), ("wandb", "_has_wandb")])
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, flag: str) -> None:
    # TorchRL looks for the package once, when it is imported.
    monkeypatch.setattr(importlib.import_module(f"torchrl.record.loggers.{name}"), flag, False)
    config = small_config(tmp_path / "run", f"logger={name}", "trainer.episodes=1")
    run_dir = create_run(config)
    with pytest.raises(UavrlError) as error:
        train(config, run_dir)
    assert str(error.value) == f"logger={name} needs the package {name}: run pip install 'uavrl[{name}]'."
    create_run(config)  # nothing was flown: the folder is free for another try
