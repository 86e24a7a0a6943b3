"""uavrl-pretrain end to end, again and otherwise."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.commands import in_process
from tests.helpers.states import SMALL_PRETRAINING, checkpoint_run, drifting_run, walk
from uavrl.cli import pretrain as command
from uavrl.models import TrajectoryClassifier
from uavrl.runs.weights import ARTIFACT


@pytest.fixture
def run(tmp_path: Path) -> Path:
    drifting_run(tmp_path / "run", episodes=50)
    return tmp_path / "run"


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_the_same_seed_gives_the_same_artifact_and_the_default_output_is_in_the_source(run: Path) -> None:
    assert in_process(command.main, f"run={run}", *SMALL_PRETRAINING) == 0
    assert in_process(command.main, f"run={run}", f"output={run}/other", *SMALL_PRETRAINING) == 0
    assert in_process(command.main, f"run={run}", f"output={run}/seed", *SMALL_PRETRAINING, "seed=1") == 0
    one, same, other = (ARTIFACT.about(run / name) for name in ("pretrained", "other", "seed"))
    assert one["weights_sha256"] == same["weights_sha256"] != other["weights_sha256"]
    assert one["config_sha256"] == same["config_sha256"] != other["config_sha256"]
    assert one["source"] == same["source"]


def test_from_the_checkpoint_of_a_run_with_a_given_k(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = checkpoint_run(tmp_path / "run", [walk(15, 6, rng) for _ in range(30)])
    arguments = [f"run={tmp_path / 'run'}", *SMALL_PRETRAINING, "pretrain.k=7", "pretrain.compare_k=20"]
    assert in_process(command.main, *arguments) == 0
    about = ARTIFACT.about(tmp_path / "run" / "pretrained")
    assert about["source"]["name"] == f"run/checkpoints/{path.name}"
    assert about["k"] == 7 != about["sse"]["elbow"]
    assert list(about["class_sizes"]) == [
        "PSAE and k-means, k = 7",
        "PSAE and classifier, k = 7",
        "PSAE and k-means, k = 20",
    ]
    assert about["class_sizes"]["PSAE and k-means, k = 20"]["classes"] == 20
    assert about["class_sizes"]["PSAE and k-means, k = 20"]["mean"] == 400 / 20
    assert TrajectoryClassifier.load(tmp_path / "run" / "pretrained").k == 7


def test_without_a_curve(run: Path) -> None:
    assert in_process(command.main, f"run={run}", *SMALL_PRETRAINING, "pretrain.k=3", "pretrain.clusters=[]") == 0
    assert names(run / "pretrained") == ["artifact.json", "artifact.safetensors", "class_sizes.png"]
    assert ARTIFACT.about(run / "pretrained")["sse"] == {"k": [], "sse": [], "elbow": None}


def test_a_short_run_is_used_whole_and_that_is_said(run: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "uavrl.cli.pretrain", f"run={run}", *SMALL_PRETRAINING, "pretrain.states=5000"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    source = ARTIFACT.about(run / "pretrained")["source"]
    assert source["states_drawn"] == source["states"] < 5000
    assert "fewer than pretrain.states=5000: all are used" in done.stderr


def test_one_shot_learning_is_counted_beside(run: Path) -> None:
    assert in_process(command.main, f"run={run}", *SMALL_PRETRAINING, "pretrain.one_shot=true") == 0
    sizes = ARTIFACT.about(run / "pretrained")["class_sizes"]
    assert next(iter(sizes)) == "one-shot learning"
    assert 1 <= sizes["one-shot learning"]["largest"] <= 400


def test_progress_bars_are_shown_if_asked_for(run: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert in_process(command.main, f"run={run}", *SMALL_PRETRAINING, "progress=true") == 0
    err = capfd.readouterr().err
    assert all(name in err for name in ("epochs of the autoencoder |", "values of k |", "epochs of the classifier |"))
