"""What a result depends on is one hash, which says whether it may be taken for that of another command."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest

from uavrl.config import EvaluateConfig, compose, validate
from uavrl.evaluation import identity
from uavrl.evaluation.identity import inputs_digest
from uavrl.evaluation.policies import PACKAGED


def digest(*overrides: str) -> str:
    config = compose(*overrides, name="evaluate")
    return inputs_digest(config, validate(config, EvaluateConfig))


@pytest.fixture
def policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An exported policy, named as seen from the folder in which the test runs."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(PACKAGED / "best", tmp_path / "pol")
    return tmp_path / "pol"


@pytest.mark.parametrize("name", ["run=pol", "policy=pol/"])
def test_another_policy_in_a_folder_of_the_same_name_is_another(name: str, policy: Path) -> None:
    before = digest(name)
    assert digest(name) == before
    shutil.rmtree(policy)
    shutil.copytree(PACKAGED / "best_dynamic", policy)
    assert digest(name) != before


def test_the_folder_itself_and_where_the_result_goes_do_not_matter(policy: Path) -> None:
    before = digest("run=pol")
    policy.rename(policy.with_name("moved"))
    assert digest("run=moved", "output=elsewhere.json", "progress=false") == before


@pytest.mark.parametrize("name", ["contract.json", "config.yaml", "policy.json", "lidar_directions.csv"])
def test_a_contract_with_other_guards_is_another_policy(name: str, policy: Path) -> None:
    before = digest("run=pol")
    with (policy / name).open("a") as file:
        file.write(" ")
    assert digest("run=pol") != before


def test_a_lidar_of_ones_own_counts_by_its_content(policy: Path) -> None:
    lidar, rays = policy / "my.yaml", policy / "rays.csv"
    asked = ("policy=vfh", "perception=range_image", f"env.lidar={lidar}")
    rays.write_text("0,0\n10,0\n")
    lidar.write_text("directions: rays.csv\n")
    seen = [digest(*asked)]
    rays.write_text("0,0\n20,0\n")
    seen.append(digest(*asked))
    lidar.write_text("directions: rays.csv\nmax_range: 20\n")
    seen.append(digest(*asked))
    assert len(set(seen)) == 3


def test_tasks_worlds_and_version_count(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = "policy=vfh", "perception=range_image"
    seen = [digest(*asked), digest(*asked, "seed=3"), digest(*asked, "env.world.obstacles=90")]
    monkeypatch.setattr(identity, "versions", lambda: {"uavrl": "9.9"})
    assert len({*seen, digest(*asked)}) == 4


@pytest.mark.parametrize("folder", ["onb", "./onb"])
def test_a_policy_for_a_companion_computer_has_no_weights(folder: str, policy: Path) -> None:
    (policy.parent / "onb").mkdir()
    shutil.copy(policy / "contract.json", policy.parent / "onb")
    (policy.parent / "onb" / "policy.onnx").write_bytes(b"one")
    before = digest(f"policy={folder}")
    (policy.parent / "onb" / "policy.onnx").write_bytes(b"two")
    assert digest(f"policy={folder}") != before


def test_a_model_of_stable_baselines_counts_by_its_content(policy: Path) -> None:
    (policy / "deep").mkdir()
    seen = []
    for text in ("one", "two"):
        with zipfile.ZipFile(policy / "deep" / "ppo.zip", "w") as archive:
            archive.writestr("data", text)
        seen.append(digest("policy=pol/deep/ppo.zip", "packages=[stable_baselines3]"))
    assert seen[0] != seen[1]


def test_a_folder_called_like_a_baseline_is_not_the_policy(policy: Path) -> None:
    before = digest("policy=vfh", "perception=range_image")
    (policy.parent / "vfh").mkdir()
    assert digest("policy=vfh", "perception=range_image") == before
