"""What the tutorials share: the commands, typed from Python."""

import os
import shlex
import subprocess
import sys

os.environ.setdefault("RL_LOGGING_LEVEL", "ERROR")  # TorchRL tells which storages it makes


def sh(line: str) -> None:
    """Runs one of uavrl's commands and prints what it says."""
    command, *arguments = shlex.split(line)
    module = f"uavrl.cli.{command.removeprefix('uavrl-')}"
    told = subprocess.run([sys.executable, "-m", module, *arguments], capture_output=True, text=True, check=False)
    print(told.stdout.rstrip())
    if told.returncode:
        raise SystemExit(told.stderr)


def size(name: str, usual: int) -> int:
    """A size of a tutorial, which the environment may make smaller."""
    return int(os.environ.get(name, usual))
