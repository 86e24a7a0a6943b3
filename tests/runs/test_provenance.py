from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from uavrl.runs.provenance import commit_of


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
