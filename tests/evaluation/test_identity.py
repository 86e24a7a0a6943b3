"""What a result depends on is one hash, which says whether it may be taken for that of another command."""

from __future__ import annotations

import shutil
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


@pytest.mark.parametrize("name", ["contract.json", "config.yaml", "policy.json"])
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
