"""Nothing in a folder that somebody sent is run, by no command and by no process that one starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.commands import SMALL_EVALUATION, TINY

ROOT = Path(__file__).parents[3]
PLANTED = (
    *("pickle", "torch", "html", "types", "json", "socket", "hydra", "numpy", "pybullet", "embreex", "joblib", "ray"),
    *("submitit", "cloudpickle", "tensordict", "torchrl", "multiprocessing", "sitecustomize", "usercustomize"),
)
RAN = "ran"
TRAINING = {
    "async": ["collector=async"],
    "ray": ["collector=ray", "collector.workers=1"],
    "joblib": ["-m", "seed=0,1", "hydra/launcher=joblib"],
    "submitit": ["-m", "seed=0", "hydra/launcher=submitit_local"],
}
SCRIPT = "import sys; sys.argv[0] = 'uavrl'; from uavrl.cli.main import main; main()"


@pytest.fixture
def sent(run_dir: Path) -> Path:
    """A run folder with modules in it that leave a mark where they are imported."""
    for name in [*PLANTED, "uavrl"]:
        (run_dir / f"{name}.py").write_text(f"open({str(run_dir / RAN)!r}, 'a').write({name!r})\nraise SystemExit(9)\n")
    return run_dir


def typed(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command as its console script runs it, in a folder: Python imports from the script's own folder first."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONSAFEPATH", None)
    script = folder.parent / "bin" / "uavrl"
    script.parent.mkdir(exist_ok=True)
    script.write_text(f"if __name__ == '__main__':\n    {SCRIPT}\n")
    return subprocess.run(
        [sys.executable, str(script), *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=500,
    )


@pytest.mark.parametrize(
    "command",
    [
        ["evaluate", "run=.", *SMALL_EVALUATION],
        ["evaluate", "run=.", "suite=[static,dense]", "episodes=2"],
        ["replay", "run=.", "progress=false"],
        ["train", "resume=.", "trainer.episodes=6"],
        *(
            ["train", *(["-m"] if "-m" in more else []), *TINY, *[m for m in more if m != "-m"]]
            for more in TRAINING.values()
        ),
    ],
    ids=["evaluate", "suite", "replay", "resume", *TRAINING],
)
def test_planted_modules_do_not_run(sent: Path, tmp_path: Path, command: list[str]) -> None:
    more = ["run_dir=" + str(tmp_path / "new")] if command[0] == "train" and "resume=." not in command else []
    more += ["hydra.sweep.dir=" + str(tmp_path / "sweep")] if "-m" in command else []
    done = typed(sent, *command, *more)
    assert not (sent / RAN).exists(), (sent / RAN).read_text()
    assert done.returncode == 0, done.stderr


def test_python_m_uavrl_is_uavrl(tmp_path: Path) -> None:
    command = [sys.executable, "-P", "-m", "uavrl", "--version"]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert done.stdout.startswith("uavrl "), done.stderr
