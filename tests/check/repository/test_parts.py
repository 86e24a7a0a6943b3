"""The Python of docs/parts.md runs: the snippets as one script, and the complete script on its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from tests.helpers.folders import ROOT

SNIPPETS = 3
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs/parts.md").read_text(encoding="utf-8"), re.DOTALL)
ERRORS = ("-W", "error::FutureWarning", "-W", "default::UserWarning")


def printed(code: str, folder: Path) -> list[str]:
    found = os.pathsep.join([str(ROOT), str(ROOT / "onboard"), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": found}
    command = [sys.executable, *ERRORS, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert "conflicting batch_sizes" not in done.stderr and "FutureWarning" not in done.stderr
    return done.stdout.splitlines()


def test_the_snippets_run_as_one_script(tmp_path: Path) -> None:
    assert printed("\n".join(BLOCKS[:SNIPPETS]), tmp_path) == [
        "torch.Size([4, 10, 1])",
        "torch.Size([2, 432])",
        "(105,) (8, 105)",
    ]


def test_the_script_trains_with_the_light_install_alone(tmp_path: Path) -> None:
    """Four of its episodes, where neither simulator nor trainer can be imported."""
    _, _, _, script = BLOCKS
    assert "in range(100):" in script
    none = (
        "import sys\nfor name in ('pybullet', 'embreex', 'gymnasium', 'hydra', 'sklearn'): sys.modules[name] = None\n"
    )
    after = "\nassert all(value.isfinite().all() for value in losses.values()), losses\n"
    after += "assert 'reward_raw' in buffer[:]['next'].keys() and len(loss.collisions)\n"
    lines = printed(none + script.replace("in range(100):", "in range(4):") + after, tmp_path)
    told = [line for line in lines if line.startswith("episode ")]
    assert len(told) == 4 and all(line.endswith((", arrived", ", collided", ", out of time")) for line in told)
