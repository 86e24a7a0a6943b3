"""The wheel works outside the checkout, and losses, transforms and models need no simulator."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

import uavrl
from tests.helpers.commands import TINY

ROOT = Path(__file__).resolve().parents[3]

# -S: no .pth file runs, so that an editable installation of the checkout stays out of sight.
TRAIN = """
import sys
unpacked, onboard, site_packages, *arguments = sys.argv[1:]
sys.path[:0] = [unpacked, onboard]
sys.path.append(site_packages)
import uavrl
from uavrl.config import conf_dir
from uavrl.cli.train import main
assert uavrl.__file__.startswith(unpacked), uavrl.__file__
assert str(conf_dir()).startswith(unpacked), conf_dir()
sys.argv = ["uavrl-train", *arguments]
main()
"""


def commands(entry_points: str) -> set[str]:
    """The console commands that a wheel installs, as ``NAME = MODULE:FUNCTION``."""
    return set(re.findall(r"^(\S+ = \S+:\S+)$", entry_points, re.MULTILINE))


def declared(folder: Path) -> set[str]:
    """The same as pyproject.toml names them."""
    scripts = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["scripts"]
    return {f"{name} = {target}" for name, target in scripts.items()}


def built(source: Path, folder: Path) -> Path:
    """The wheel of the package in a folder."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(source)]
    try:
        import hatch_fancy_pypi_readme  # noqa: F401
        import hatchling  # noqa: F401
    except ImportError:
        pass
    else:
        command.append("--no-build-isolation")
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    (wheel,) = folder.glob("uavrl*.whl")
    return wheel


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    wheel = built(ROOT, folder)
    assert wheel.stat().st_size <= 4_000_000
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "unpacked")
    return folder / "unpacked"


def test_the_wheel_holds_the_package_and_its_configuration_alone(unpacked: Path) -> None:
    tops = {p.name for p in unpacked.iterdir()}
    assert {t for t in tops if not t.endswith(".dist-info")} == {"uavrl"}
    for folder, packed in ((ROOT / "conf", unpacked / "uavrl/conf"), (ROOT / "uavrl", unpacked / "uavrl")):
        for suffix in ("*.yaml", "*.py", "py.typed", "*.json", "*.html", "*.css", "*.js", "*.safetensors"):
            for file in folder.rglob(suffix):
                assert (packed / file.relative_to(folder)).is_file(), file
    (entry_points,) = unpacked.glob("*.dist-info/entry_points.txt")
    assert commands(entry_points.read_text()) == declared(ROOT)
    assert list(unpacked.glob("*.dist-info/licenses/LICENSE"))
    (metadata,) = unpacked.glob("*.dist-info/METADATA")
    told = metadata.read_text(encoding="utf-8")
    assert f"/uavrl/blob/v{uavrl.__version__}/docs/results.md" in told
    assert not re.search(r"\]\((?!https?:|#)", told.partition("# uavrl")[2])
    assert "Requires-Dist: uavrl-onboard" in told


def test_the_wheel_of_what_flies_holds_all_of_its_package_and_its_commands(tmp_path: Path) -> None:
    source = ROOT / "onboard"
    with zipfile.ZipFile(built(source, tmp_path)) as archive:
        packed = set(archive.namelist())
        (entry_points,) = [archive.read(name).decode() for name in packed if name.endswith("/entry_points.txt")]
    files = [path for path in (source / "uavrl_onboard").rglob("*") if path.is_file()]
    assert {str(path.relative_to(source)) for path in files if "__pycache__" not in path.parts} <= packed
    assert {name.partition("/")[0].partition("-")[0] for name in packed} == {"uavrl_onboard"}
    assert commands(entry_points) == declared(source)


@pytest.mark.slow
def test_the_wheels_train_outside_the_checkout(unpacked: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(built(ROOT / "onboard", tmp_path)) as archive:
        archive.extractall(tmp_path / "onboard")
    arguments = [*TINY, "trainer.episodes=2", f"run_dir={tmp_path / 'run'}"]
    site_packages = sysconfig.get_path("purelib")
    folders = [str(unpacked), str(tmp_path / "onboard"), site_packages]
    command = [sys.executable, "-I", "-S", "-c", TRAIN, *folders, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 0, result.stderr
    assert json.loads((tmp_path / "run/summary.json").read_text())["episodes"] == 2
