"""Which state of the code made a file."""

import platform
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("uavrl-onboard", "numpy", "scipy", "onnxruntime")  # whose versions bear on a flight


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str | None]:
    """The versions of Python and of the packages that are installed, and the commit, None outside of a checkout."""
    found: dict[str, str | None] = {"commit": commit(), "python": platform.python_version()}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


@cache
def commit() -> str | None:
    """The git commit of the checkout that this package is imported from, asked once per process."""
    return commit_of(Path(__file__).resolve().parent)


def commit_of(package: Path) -> str | None:
    """The git commit of the checkout that holds a package, None outside of a checkout."""
    git = partial(subprocess.run, check=True, capture_output=True, text=True, timeout=20)
    command = ["git", "--no-optional-locks", "-C", str(package)]
    try:
        git([*command, "ls-files", "--error-unmatch", "__init__.py"])  # is it tracked, or only in another's repository?
        found = git([*command, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"])
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
