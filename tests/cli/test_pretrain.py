"""``uavrl-pretrain`` end to end on a small run; bad input ends in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.commands import in_process
from tests.helpers.states import SMALL_PRETRAINING, checkpoint_run, drifting_run, walk
from uavrl.cli import pretrain as command
from uavrl.models import TrajectoryClassifier
from uavrl.pretraining import pipeline
from uavrl.pretraining.states import read_states
from uavrl.runs.weights import ARTIFACT


@pytest.fixture
def run(tmp_path: Path) -> Path:
    drifting_run(tmp_path / "run", episodes=50)
    return tmp_path / "run"


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


# ---------------------------------------------------------------------- end to end


def test_from_a_run_to_an_artifact(run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out_folder = tmp_path / "artifact"
    assert in_process(command.main, f"run={run}", f"output={out_folder}", *SMALL_PRETRAINING) == 0
    assert names(out_folder) == ["artifact.json", "artifact.safetensors", "class_sizes.png", "elbow.png"]
    about = ARTIFACT.about(out_folder)
    assert about["k"] == about["sse"]["elbow"] in about["sse"]["k"]
    assert about["sse"]["sse"][-1] < about["sse"]["sse"][0]
    assert about["source"]["name"].startswith("run/checkpoint") and about["source"]["states_drawn"] == 400
    assert about["source"]["episodes"] == 50 == sum(about["source"]["outcomes"].values())
    assert about["classifier"]["held_out_accuracy"] > 0.7 and 0 < about["classifier"]["held_out_states"] < 200
    assert about["config"]["pretrain"]["hidden"] == 16
    assert about["perception"] == {"angles": "folded"}
    assert about["versions"]["torch"] == version("torch")
    text = (out_folder / "artifact.json").read_text()
    assert "NaN" not in text and str(tmp_path) not in text, "plain JSON that names no place of this machine"
    assert all(len(about[key]) == 64 for key in ("config_sha256", "weights_sha256"))
    said = capfd.readouterr().out
    assert f"{about['k']} classes (elbow of the SSE curve: {about['k']})" in said
    assert f"Artifact: {out_folder}" in said

    classifier = TrajectoryClassifier.load(out_folder)
    assert classifier.perception == about["perception"]
    states = torch.from_numpy(read_states(run).states)
    labels = classifier(states)
    nearest = torch.cdist(classifier.encode(states), classifier.centres).argmin(-1)
    assert (labels == nearest).float().mean() > 0.7


# ---------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Give run=RUN_FOLDER, of a training whose states are learned from"),
        (["recording=none"], "There is no key 'recording'"),
        (["pretrain=fast"], "fast"),
        (["seed=x"], "seed"),
        (["run=none"], "Expected a run folder at none"),
        (["run=run", "pretrain.states=0"], "pretrain.states must be at least 1"),
        (["run=run", "pretrain.states=10"], "Expected at least as many states as clusters (16), got 10"),
        (["run=run", "pretrain.k=100000"], "Expected at least as many states as clusters (100000)"),
        (["run=run", "output=file"], "file/artifact.json cannot be written"),
        (["run=run", "output=file/below"], "cannot be written"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(
    arguments: list[str],
    said: str,
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Callable[..., str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("kept")
    assert said in refused(command.main, *SMALL_PRETRAINING, *arguments)
    assert names(tmp_path) == ["file", "run"]
    assert names(run) == ["checkpoints", "config.yaml"]


@pytest.mark.parametrize(
    ("lengths", "said"),
    [([40], "Expected 2 or more episodes"), ([2] * 20, "Expected three states in a row")],
)
def test_too_few_states_or_episodes_are_refused(
    lengths: list[int], said: str, tmp_path: Path, refused: Callable[..., str]
) -> None:
    rng = np.random.default_rng(0)
    checkpoint_run(tmp_path / "few", [walk(length, 6, rng) for length in lengths])
    assert said in refused(command.main, f"run={tmp_path / 'few'}", *SMALL_PRETRAINING)


def test_a_taken_folder_is_refused_before_the_states_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setattr(pipeline, "read_states", lambda _: pytest.fail("the states were read"))
    (tmp_path / "pretrained").mkdir()
    (tmp_path / "pretrained" / ARTIFACT.json).write_text("{}", encoding="utf-8")
    (tmp_path / "config.yaml").touch()
    assert "already contains an artifact" in refused(command.main, f"run={tmp_path}", *SMALL_PRETRAINING)


def test_an_artifact_is_not_overwritten(run: Path, refused: Callable[..., str]) -> None:
    (run / "pretrained").mkdir()
    (run / "pretrained" / "artifact.json").write_text("kept")
    assert "already contains an artifact" in refused(command.main, f"run={run}", *SMALL_PRETRAINING)
    assert (run / "pretrained" / "artifact.json").read_text() == "kept"


def test_ctrl_c_leaves_no_artifact(
    run: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "train_classifier", interrupted)
    assert in_process(command.main, f"run={run}", *SMALL_PRETRAINING) == 130
    assert names(run / "pretrained") == []
    assert "uavrl: stopped." in capfd.readouterr().err
