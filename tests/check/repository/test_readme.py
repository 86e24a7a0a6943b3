"""The README's Python runs, from top to bottom."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.helpers.own_parts import SMALL

ROOT = Path(__file__).resolve().parents[3]
README = ROOT / "README.md"


def run_blocks(page: Path, count: int) -> dict[str, Any]:
    """The names that a page's Python leaves behind, run from top to bottom as one script."""
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    assert len(blocks) == count
    names: dict[str, Any] = {}
    exec(compile("\n".join(blocks), str(page), "exec"), names)
    assert names["policy"].source["training_steps"] > 0
    return names


def test_its_python_runs_as_one_script(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("torchrl._utils.RL_WARNINGS", True)  # as for who types it: our commands turn them off
    names = run_blocks(README, 3)
    assert capsys.readouterr().out.splitlines() == [
        "torch.Size([4, 10, 1])",
        "torch.Size([2, 72])",
        "(105,)",
    ]
    for each in ("env", "reduced", "valley"):
        names[each].close()


def test_the_python_of_the_quick_start_runs_as_one_script() -> None:
    names = run_blocks(ROOT / "docs/quick_start.md", 2)
    assert names["faces"].shape == (8, 32)
    assert names["steps"].shape == (4, 10)
    names["env"].close()


def test_what_you_bring_is_trained(tmp_path: Path) -> None:
    section = README.read_text().split("## Bring your own\n")[1].split("\n## ")[0]
    command = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)[0]
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    typed = " ".join([command.strip(), *SMALL, f"run_dir={tmp_path / 'run'}"])
    done = subprocess.run(typed, shell=True, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    written = yaml.safe_load((tmp_path / "run/config.yaml").read_text())
    targets = {part: written[part]["_target_"] for part in ("env", "reward", "actor_penalty")}
    assert targets == {
        "env": "own_parts.env.Corridor",
        "reward": "own_parts.reward.HurryReward",
        "actor_penalty": "own_parts.calm.Calm",
    }
