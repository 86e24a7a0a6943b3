"""What is installed where, which Python `make` takes, and what it says where none fits."""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = tuple(f".venv/bin/uavrl-{name} " for name in ("train", "evaluate", "replay"))


def make(folder: Path, pythons: dict[str, int], *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs make in a new checkout, on a machine with these Pythons and the exit codes of their self-test."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, folder)
    (folder / "onboard").mkdir()
    shutil.copy(ROOT / "onboard/pyproject.toml", folder / "onboard")
    (folder / "bin").mkdir()
    for name, code in pythons.items():
        (folder / "bin" / name).write_text(f"#!/bin/sh\nexit {code}\n")
        (folder / "bin" / name).chmod(0o755)
    environment = {"PATH": str(folder / "bin")}
    command = [str(shutil.which("make")), "-C", str(folder), "SHELL=/bin/sh", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


@needs_make
@pytest.mark.parametrize(
    ("pythons", "taken"),
    [
        ({"python3.11": 0, "python3.12": 0, "python3": 0}, "python3.12"),
        ({"python3.13": 127, "python3.11": 0}, "python3.11"),  # a shim for a Python that is not switched on
        ({"python3.13": 1, "python3": 0}, "python3"),  # Debian's without its venv package
    ],
)
def test_it_takes_the_newest_python_that_fits(pythons: dict[str, int], taken: str, tmp_path: Path) -> None:
    result = make(tmp_path, pythons, "--dry-run", "setup")
    assert f"{taken} -m venv .venv" in result.stdout.splitlines(), result


@needs_make
def test_a_python_may_be_named(tmp_path: Path) -> None:
    result = make(tmp_path, {"python3.12": 0}, "--dry-run", "setup", "PYTHON=/opt/python")
    assert "/opt/python -m venv .venv" in result.stdout.splitlines(), result


@needs_make
@pytest.mark.parametrize("named", [[], ["PYTHON=python3"]])
def test_one_sentence_where_none_fits(named: list[str], tmp_path: Path) -> None:
    result = make(tmp_path, {"python3": 1}, "setup", *named)
    assert result.returncode != 0
    sentence = result.stdout.splitlines()[1 if "directory" in result.stdout.splitlines()[0] else 0]
    assert sentence.startswith("uavrl needs Python 3.11, 3.12 or 3.13 with its venv module"), result
    assert not (tmp_path / ".venv").exists()


@needs_make
@pytest.mark.parametrize("asked", ["seed=1", "env=dynamic seed=1"])
def test_make_train_evaluates_and_shows_what_it_trained_in_valleys_that_it_never_saw(
    asked: str, tmp_path: Path
) -> None:
    """The environment is the run's own."""
    result = make(tmp_path, {"python3.12": 0}, "--dry-run", "train", "RUN=runs/a", f"ARGS={asked}")
    lines = [line for line in result.stdout.splitlines() if line.startswith(COMMANDS)]
    train, replay, evaluate = [shlex.split(re.split(r" (?:>|\|\|) ", line)[0]) for line in lines]
    assert train[1:] == ["preset=dagger", "run_dir=runs/a", *asked.split()]
    assert evaluate[1:] == ["run=runs/a", "episodes=100", "processes=null"], "unseen valleys are the default"
    assert replay[1:] == ["run=runs/a", "valleys=[100]", "episodes=4", "output=runs/a/replay.html"]
    assert lines[1].endswith("& \\"), "the second core draws meanwhile"


@needs_make
@pytest.mark.parametrize("fails", ["evaluate", "replay"])
def test_make_train_fails_where_the_evaluation_or_the_page_does(fails: str, tmp_path: Path) -> None:
    (tmp_path / ".venv/bin").mkdir(parents=True)
    (tmp_path / ".venv/.ready").touch()
    for name in ("uavrl-train", "uavrl-evaluate", "uavrl-replay", "python"):
        command = tmp_path / ".venv/bin" / name
        command.write_text(f"#!/bin/sh\necho {name} was here\nexit {int(name.endswith(fails))}\n")
        command.chmod(0o755)
    (tmp_path / "runs/a").mkdir(parents=True)
    result = make(tmp_path, {"python3.12": 0}, "train", "RUN=runs/a", "--old-file=.venv/.ready")
    assert result.returncode != 0 and "python was here" not in result.stdout


def test_a_python_without_what_uavrl_needs_is_told_in_a_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-S", "-m", "uavrl", "--version"]  # -S: without what is installed
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert re.fullmatch(r"uavrl needs the package '\w+', which .* does not have: activate .*\n", result.stderr)


def test_the_makefile_asks_for_what_the_package_asks_for() -> None:
    assert 'requires-python = ">=3.11,<3.14"' in (ROOT / "pyproject.toml").read_text()
    assert "(3, 11) <= sys.version_info < (3, 14)" in (ROOT / "Makefile").read_text()
    assert os.access(ROOT / ".ci/check_python", os.X_OK)


def requirements(*extras: str, folder: Path = ROOT) -> list[Requirement]:
    """What ``pip install 'PACKAGE[EXTRAS]'`` asks for, extras of extras included."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    asked = [*map(Requirement, project["dependencies"])]
    for extra in extras:
        for found in map(Requirement, project["optional-dependencies"][extra]):
            asked += requirements(*found.extras, folder=folder) if found.name == project["name"] else [found]
    return asked


def test_all_but_the_simulator_installs_where_it_has_no_wheels() -> None:
    train = requirements("train")

    def installed(**environment: str) -> set[str]:
        return {r.name for r in train if r.marker is None or r.marker.evaluate(environment)}

    simulators = {"pybullet", "pybullet-arm64", "embreex"}
    linux, mac = {"sys_platform": "linux"}, {"sys_platform": "darwin", "platform_machine": "arm64"}
    for version, bullet in (("3.11", "pybullet"), ("3.12", "pybullet-arm64"), ("3.13", "pybullet-arm64")):
        pc = installed(**linux, platform_machine="x86_64", python_version=version)
        assert pc & simulators == {bullet, "embreex"}
        assert installed(**mac, python_version=version) & simulators == {"pybullet-arm64", "embreex"}
        jetson = installed(**linux, platform_machine="aarch64", python_version=version)
        assert not jetson & simulators
        assert {"torch", "torchrl", "hydra-core"} <= jetson


def test_all_but_cyclone_dds_installs_where_it_has_no_wheels() -> None:
    flies = requirements("all", folder=ROOT / "onboard")
    linux, mac = {"sys_platform": "linux"}, {"sys_platform": "darwin", "platform_machine": "arm64"}
    for machine, left_out in (
        ({**linux, "platform_machine": "x86_64"}, set()),
        ({**linux, "platform_machine": "aarch64"}, {"cyclonedds"}),
        (mac, set()),
    ):
        installed = {r.name for r in flies if r.marker is None or r.marker.evaluate(machine)}
        assert {r.name for r in flies} - installed == left_out, machine


IMPORTED_AS = {
    **{"yaml": "pyyaml", "hydra": "hydra-core", "sklearn": "scikit-learn", "PIL": "pillow"},
    **{"pydantic_core": "pydantic", "onnx_ir": "onnxscript"},  # one release of the former fits one of the latter
}
OF_THE_USER = {"stable_baselines3"}  # opens the models of a user who has it


@pytest.mark.parametrize(("folder", "package"), [(ROOT, "uavrl"), (ROOT / "onboard", "uavrl_onboard")])
def test_each_library_that_is_imported_is_declared(folder: Path, package: str) -> None:
    extras = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    declared = {r.name for r in requirements(*extras.keys() - {"dev", "docs"}, folder=folder)}
    if package == "uavrl":
        declared |= {r.name for r in requirements("pages", folder=ROOT / "onboard")}
    imported = set()
    for path in (folder / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            imported |= {name.partition(".")[0] for name in names}
    libraries = imported - sys.stdlib_module_names - {"uavrl", "uavrl_onboard"} - OF_THE_USER
    assert libraries > {"numpy", "pydantic"}
    undeclared = {IMPORTED_AS.get(each, each).replace("_", "-") for each in libraries} - declared
    assert not undeclared


def test_the_light_install_brings_neither_simulator_nor_trainer() -> None:
    light = {r.name for r in requirements()}
    assert light == {
        *("uavrl-onboard", "torch", "torchrl", "tensordict"),
        *("numpy", "scipy", "pydantic", "omegaconf", "pyyaml", "safetensors", "sortedcontainers"),
    }
    sim = {r.name for r in requirements("sim")} - light
    assert sim == {"pybullet", "pybullet-arm64", "embreex", "gymnasium", "trimesh", "pypcd4"}
    train = {r.name for r in requirements("train")} - light - sim
    assert train == {"scikit-learn", "threadpoolctl", "kneed", "hydra-core", "tqdm", "filelock"}
