"""Weights come back as they were saved, and what is damaged or foreign is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from uavrl.errors import UavrlError
from uavrl.models import TrajectoryClassifier
from uavrl.models import psae as module
from uavrl.models.psae import packaged_artifact
from uavrl.runs.weights import ARTIFACT


def classifier(k: int = 9) -> TrajectoryClassifier:
    torch.manual_seed(0)
    made = TrajectoryClassifier(6, features=3, hidden=8, classifier_hidden=(7, 5), k=k)
    for buffer in made.buffers():
        buffer.copy_(torch.rand_like(buffer) + 0.5)
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "artifact").mkdir()
    classifier().save(tmp_path / "artifact", {"k": 9, "note": "kept"})
    return tmp_path / "artifact"


def change(folder: Path, **values: object) -> None:
    about = json.loads((folder / "artifact.json").read_text())
    (folder / "artifact.json").write_text(json.dumps({**about, **values}))


def test_it_comes_back_as_it_was_saved(folder: Path) -> None:
    loaded, saved = TrajectoryClassifier.load(folder), classifier()
    states = 20 * torch.randn(200, 6)
    assert torch.equal(loaded(states), saved(states))
    assert len(loaded(states).unique()) > 1
    for name, tensor in saved.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
    assert not loaded.training and not any(p.requires_grad for p in loaded.parameters())
    assert sorted(p.name for p in folder.iterdir()) == ["artifact.json", "artifact.safetensors"]


def test_labels_are_those_of_encoder_scaler_and_network() -> None:
    made, states = classifier(), 20 * torch.randn(50, 6)
    scaled = (made.encoder(states) - made.mean) / made.scale
    expected = made.classifier(scaled).argmax(-1)
    labels = made(states)
    assert torch.equal(labels, expected) and labels.dtype == torch.int64
    assert torch.equal(made(states.reshape(5, 10, 6)), labels.reshape(5, 10))
    assert made(states[0]).shape == ()


def test_states_of_another_width_are_refused() -> None:
    with pytest.raises(UavrlError, match=r"Expected states \[\*B, 6\], got \[4, 105\]"):
        classifier()(torch.zeros(4, 105))


def test_json_tells_sizes_shapes_and_what_was_reported(folder: Path) -> None:
    about = ARTIFACT.about(folder)
    assert (about["format"], about["version"], about["note"]) == ("uavrl.trajectory_classifier", 1, "kept")
    assert about["sizes"] == {"inputs": 6, "features": 3, "hidden": 8, "classifier_hidden": [7, 5], "k": 9}
    assert about["shapes"]["centres"] == [9, 3] and about["shapes"]["encoder.0.weight"] == [8, 6]


@pytest.mark.parametrize("position", [3, 200, -1])
def test_one_changed_byte_is_found(folder: Path, position: int) -> None:
    content = bytearray((folder / "artifact.safetensors").read_bytes())
    content[position] ^= 1
    (folder / "artifact.safetensors").write_bytes(content)
    with pytest.raises(UavrlError, match=r"artifact.safetensors is damaged .its checksum differs"):
        TrajectoryClassifier.load(folder)


def test_truncated_or_missing_weights_are_refused(folder: Path) -> None:
    path = folder / "artifact.safetensors"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(UavrlError, match="its checksum differs"):
        TrajectoryClassifier.load(folder)
    path.unlink()
    with pytest.raises(UavrlError, match="found no such file: copy the whole folder"):
        TrajectoryClassifier.load(folder)


@pytest.mark.parametrize("sizes", [{"k": 8}, {"inputs": 105}, {"classifier_hidden": [7]}])
def test_sizes_that_are_not_those_of_the_weights_are_refused(folder: Path, sizes: dict[str, object]) -> None:
    change(folder, sizes={**ARTIFACT.about(folder)["sizes"], **sizes})
    with pytest.raises(UavrlError, match=r"is damaged .its sizes are not those of its weights"):
        TrajectoryClassifier.load(folder)


@pytest.mark.parametrize("sizes", [{}, {"k": "many"}, {"k": -1}, {"depth": 3}])
def test_sizes_that_make_no_sense_are_refused(folder: Path, sizes: dict[str, object]) -> None:
    change(folder, sizes=sizes)
    with pytest.raises(UavrlError, match="is damaged"):
        TrajectoryClassifier.load(folder)


@pytest.mark.parametrize("text", ["", "[]", "null", '{"format": "other"}', "\x00"])
def test_foreign_json_is_refused(folder: Path, text: str) -> None:
    (folder / "artifact.json").write_text(text)
    with pytest.raises(UavrlError, match=r"is not of uavrl.trajectory_classifier 1"):
        TrajectoryClassifier.load(folder)


def test_another_version_or_json_without_a_checksum_is_refused(folder: Path) -> None:
    change(folder, version=2)
    with pytest.raises(UavrlError, match=r"is not of uavrl.trajectory_classifier 1, which this version"):
        TrajectoryClassifier.load(folder)
    (folder / "artifact.json").write_text(json.dumps({"format": "uavrl.trajectory_classifier", "version": 1}))
    with pytest.raises(UavrlError, match="its checksum differs"):
        TrajectoryClassifier.load(folder)


def test_a_missing_artifact_is_named(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match=r"artifact.json and found no such file: make one with uavrl-pretrain"):
        TrajectoryClassifier.load(tmp_path / "none")


def test_the_packaged_artifact_is_found_beside_the_code(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UavrlError, match="the artifact no_such_artifact"):
        packaged_artifact("no_such_artifact")
    monkeypatch.setattr(module, "__file__", str(tmp_path / "models" / "psae.py"))
    (tmp_path / "artifacts").mkdir()
    folder.rename(tmp_path / "artifacts" / "abr_plus_static")
    assert TrajectoryClassifier.load(packaged_artifact()).k == 9
