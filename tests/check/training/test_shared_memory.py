"""Trainings on a machine, such as a container, that has too little shared memory."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.commands import TINY

UNSHARE = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
CAN_UNSHARE = (
    shutil.which("unshare") is not None
    and subprocess.run(
        [*UNSHARE, "mount", "-t", "tmpfs", "none", "/dev/shm"], capture_output=True, check=False
    ).returncode
    == 0
)


@pytest.mark.skipif(not CAN_UNSHARE, reason="mounts of one's own are not allowed here")
@pytest.mark.parametrize(
    ("collector", "size"),
    [
        ("sync", "1k"),  # no semaphore fits
        ("async", "1k"),
        ("async", "100k"),  # no copy of the networks fits
        ("async", "400k"),  # the worker finds no room for its episodes
    ],
)
def test_too_little_shared_memory_is_named_with_its_remedy(collector: str, size: str, tmp_path: Path) -> None:
    mounted = f'mount -t tmpfs -o size={size} none /dev/shm && exec "$@"'
    arguments = [*TINY, "algo.hidden=[16,16]", f"collector={collector}", f"run_dir={tmp_path / 'run'}"]
    command = [*UNSHARE, "sh", "-c", mounted, "sh", sys.executable, "-m", "uavrl", "train", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("uavrl: ") and "/dev/shm" in last and "--shm-size" in last
