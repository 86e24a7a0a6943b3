"""Which state of the code made a run."""

import subprocess
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent


@cache
def commit() -> str | None:
    """The git commit of the checkout that uavrl is imported from, asked once per process."""
    return commit_of(PACKAGE)


def commit_of(package: Path) -> str | None:
    """The same for a package in any folder."""
    git = ["git", "--no-optional-locks", "-C", str(package)]
    try:
        # An installation inside someone else's repository is not tracked there.
        subprocess.run(
            [*git, "ls-files", "--error-unmatch", "__init__.py"], check=True, capture_output=True, timeout=20
        )
        describe = [*git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
        found = subprocess.run(describe, check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.decode().strip() or None
