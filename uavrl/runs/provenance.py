"""Which state of the code made a result, and on what: the same code gives other last digits elsewhere."""

import json
import platform
import subprocess
from contextlib import suppress
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from uavrl.runs.names import SUMMARY

PACKAGE = Path(__file__).resolve().parent.parent
# Whose versions bear on a result. PyBullet has a fork with other wheels; one of the two is installed.
PACKAGES = ("uavrl", "torch", "torchrl", "tensordict", "numpy", "pybullet", "pybullet-arm64", "embreex")
_CPUINFO = Path("/proc/cpuinfo")


def versions() -> dict[str, str | None]:
    """The versions of :data:`PACKAGES` and of Python, and uavrl's commit, None outside of a checkout."""
    found: dict[str, str | None] = {"commit": commit(), "python": platform.python_version()}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def recorded_versions(run_dir: Path) -> dict[str, str]:
    """The versions that a run was trained with, of its ``summary.json``; none where it has not ended."""
    try:
        found = json.loads((run_dir / SUMMARY).read_text(encoding="utf-8"))["versions"]
        return {str(package): str(known) for package, known in found.items() if known is not None}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def processor() -> dict[str, str]:
    """The processor's model, and which of its instruction sets PyTorch uses."""
    import torch  # here: reports ask for a commit without it

    lines = _CPUINFO.read_text(encoding="utf-8").splitlines() if _CPUINFO.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    return {"model": model, "instructions": torch.backends.cpu.get_cpu_capability()}


@cache
def commit() -> str | None:
    """The git commit of the checkout that uavrl is imported from, asked once per process."""
    return commit_of(PACKAGE)


def commit_of(package: Path) -> str | None:
    """The same for a package in any folder."""
    git = partial(subprocess.run, check=True, capture_output=True, text=True, timeout=20)
    command = ["git", "--no-optional-locks", "-C", str(package)]
    try:
        git([*command, "ls-files", "--error-unmatch", "__init__.py"])  # is it tracked, or only in another's repository?
        found = git([*command, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"])
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
