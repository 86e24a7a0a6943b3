"""What ``.ci/run`` does before the tests: it never fails, hangs or skips anything in silence."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(not Path("/bin/bash").exists(), reason="needs bash")


def install(folder: Path, **programs: str) -> tuple[subprocess.CompletedProcess[str], list[str]]:
    """Runs .ci/install_browser where only these shell scripts are installed, and returns what they were told."""
    for name in ("timeout", "sleep"):
        (folder / name).symlink_to(str(shutil.which(name)))
    log = folder / "log"
    for name, script in programs.items():
        file = folder / name.replace("_", "-")
        file.write_text(f'#!/bin/bash\necho "$@" >> {log}\n{script}\n')
        file.chmod(0o755)
    environment = {"PATH": str(folder), "UAVRL_APT_SECONDS": "1"}
    command = ["/bin/bash", str(ROOT / ".ci/install_browser")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    return done, log.read_text().splitlines() if log.exists() else []


@pytest.mark.parametrize(
    ("programs", "reason"),
    [
        ({"id": "echo 1000"}, "takes root"),
        ({"id": "echo 0"}, "has no apt-get"),
        ({"id": "echo 0", "apt_get": "exit 100"}, "the package index cannot be read"),
        ({"id": "echo 0", "apt_get": "sleep 30"}, "the package index cannot be read"),  # a network that does not answer
        ({"id": "echo 0", "apt_get": '[[ " $* " == *" update "* ]]'}, "cannot be downloaded"),
    ],
)
def test_without_a_browser_it_says_why_and_goes_on(programs: dict[str, str], reason: str, tmp_path: Path) -> None:
    done, _ = install(tmp_path, **programs)
    assert done.returncode == 0, done
    assert "The tests of pages in a browser are skipped: " in done.stderr and reason in done.stderr, done


def test_it_installs_both_programs_where_one_is_missing(tmp_path: Path) -> None:
    done, told = install(tmp_path, id="echo 0", apt_get="exit 0", chromium="exit 1")
    assert done.returncode == 0 and done.stderr == "", done
    installed = [line for line in told if line.endswith("--no-install-recommends chromium chromium-driver")]
    assert len(installed) == 2 and "--download-only" in installed[0] and "--no-download" in installed[1], told


def test_it_leaves_a_machine_with_a_browser_alone(tmp_path: Path) -> None:
    done, told = install(tmp_path, id="echo 0", apt_get="exit 0", chromium="exit 1", chromedriver="exit 1")
    assert (done.returncode, done.stdout, done.stderr, told) == (0, "", "", [])


def recordings(checkout: Path, named: str | None = None) -> tuple[str, str]:
    """What .ci/recordings finds in a checkout: the folder, and what it says."""
    environment = {"PATH": os.environ["PATH"]} | ({"UAVRL_RECORDINGS": named} if named is not None else {})
    script = f'set -euo pipefail; source "{ROOT}/.ci/recordings"; printf "%s" "${{UAVRL_RECORDINGS:-}}"'
    command = ["/bin/bash", "-c", script]
    done = subprocess.run(
        command, cwd=checkout, env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout, done.stderr


def test_recordings_beside_the_checkout_are_handed_to_the_tests(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    checkout.mkdir()
    found, told = recordings(checkout)
    assert found == "" and "set UAVRL_RECORDINGS to their folder" in told
    folder = tmp_path / "shared/data/vlp16"
    folder.mkdir(parents=True)
    found, told = recordings(checkout)
    assert Path(found).resolve() == folder and told == ""
    assert recordings(checkout, "/elsewhere") == ("/elsewhere", "")


def test_each_skipped_test_prints_its_reason() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    (shown,) = [word for word in str(options["addopts"]).split() if word.startswith("-r")]
    assert "s" in shown
    run = (ROOT / ".ci/run").read_text(encoding="utf-8")
    order = [run.index(f"\n{line}\n") for line in (".ci/install_browser", "source .ci/recordings", "make test")]
    assert order == sorted(order)
