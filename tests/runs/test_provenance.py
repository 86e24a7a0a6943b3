from __future__ import annotations

import json
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy
import pytest
import torch

import uavrl
from uavrl.runs import provenance
from uavrl.runs.provenance import commit, processor, versions
from uavrl_onboard import provenance as on_board
from uavrl_onboard.provenance import commit_of


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "package").mkdir()
    (tmp_path / "package/__init__.py").write_text("")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "one")
    git(tmp_path, "tag", "v1")
    return tmp_path / "package"


def test_the_commit_of_a_checkout(package: Path) -> None:
    head = git(package, "rev-parse", "HEAD")
    assert commit_of(package) == head
    (package / "untracked.txt").write_text("a run's output, say")
    assert commit_of(package) == head
    (package / "__init__.py").write_text("changed = True")
    assert commit_of(package) == f"{head}-dirty"


def test_an_installation_inside_another_repository_has_none(package: Path) -> None:
    installed = package.parent / "site-packages/uavrl"
    installed.mkdir(parents=True)
    (installed / "__init__.py").write_text("")
    assert commit_of(installed) is None


def test_no_repository_and_no_git(tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    assert commit_of(package) is None


def test_versions_are_of_what_bears_on_the_numbers() -> None:
    found = versions()
    assert found["uavrl"] == uavrl.__version__ and found["commit"] == commit()
    assert (found["torch"], found["numpy"]) == (version("torch"), numpy.__version__)
    assert {"python", "torchrl", "embreex"} < found.keys() and len(found.keys() & {"pybullet", "pybullet-arm64"}) == 1


def test_the_fork_of_pybullet_is_told_where_it_is_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(package: str) -> str:
        if package == "pybullet":
            raise PackageNotFoundError(package)
        return "3.2.8" if package == "pybullet-arm64" else "1"

    monkeypatch.setattr(on_board, "version", installed)
    assert versions()["pybullet-arm64"] == "3.2.8" and "pybullet" not in versions()


def test_the_processor_is_told_with_the_instructions_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    two = "processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\n\nprocessor\t: 1\nmodel name\t: Some CPU @ 2 GHz\n"
    (tmp_path / "cpuinfo").write_text(two)
    monkeypatch.setattr(provenance, "_CPUINFO", tmp_path / "cpuinfo")
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    assert processor() == {"model": "Some CPU @ 2 GHz", "instructions": "AVX2"}
    monkeypatch.setattr(provenance, "_CPUINFO", tmp_path / "none")
    monkeypatch.setattr(provenance.platform, "processor", lambda: "arm")
    assert processor()["model"] == "arm"


def test_a_run_tells_its_versions_and_its_processor(finished: Path) -> None:
    summary = json.loads((finished / "summary.json").read_text())
    assert summary["versions"] == versions() and summary["processor"] == processor()
