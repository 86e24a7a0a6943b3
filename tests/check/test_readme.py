"""The README's Python runs, from top to bottom."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
TINY_RUN = ["trainer.episodes=1", "env.num_uavs=1", "env.max_steps=3", "trainer.progress=false", "trainer.matmul=mkl"]
TINY_RUN += ["trainer.execution=captured"]  # compiling takes longer than the run


def test_its_python_runs_as_one_script() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(blocks) == 6
    names: dict[str, Any] = {}
    exec(compile("\n".join(blocks), str(README), "exec"), names)
    assert names["faces"].shape == (8, 32)
    assert names["policy"].source["training_steps"] > 0
    losses = names["loss"](names["env"].rollout(10))
    assert {"loss_actor", "loss_qvalue", "loss_lifeguard"} <= set(losses.keys())
    assert all(loss.isfinite().all() for loss in losses.values())
    assert names["valley"].reset(seed=0)[0].shape == (105,)
    names["env"].close()
    names["valley"].close()


def test_what_you_bring_is_trained(tmp_path: Path) -> None:
    section = README.read_text().split("## Bring your own\n")[1].split("\n## ")[0]
    assert len(section.strip().splitlines()) <= 25
    code, chosen, command = (
        re.findall(rf"```{kind}\n(.*?)```", section, re.DOTALL)[0] for kind in ("py", "yaml", "sh")
    )
    for path, content in (
        ("my_parts/rewards.py", code),
        ("my_conf/reward/bold.yaml", chosen),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(content)
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    typed = " ".join([command.strip(), *TINY_RUN, "run_dir=run"])
    done = subprocess.run(typed, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    written = yaml.safe_load((tmp_path / "run/config.yaml").read_text())
    assert written["reward"] == {"_target_": "my_parts.rewards.Bold", "boldness": 4.0}
