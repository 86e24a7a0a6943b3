"""Which state of the code made a result, and on what: the same code gives other last digits elsewhere."""

import json
import platform
from pathlib import Path

from uavrl.runs.names import SUMMARY
from uavrl_onboard import provenance
from uavrl_onboard.provenance import commit

__all__ = ["PACKAGES", "commit", "processor", "recorded_versions", "versions"]

# Whose versions bear on a result. PyBullet has a fork with other wheels; one of the two is installed.
PACKAGES = (
    "uavrl",
    "uavrl-onboard",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "pybullet",
    "pybullet-arm64",
    "embreex",
)
_CPUINFO = Path("/proc/cpuinfo")


def versions() -> dict[str, str | None]:
    """The versions of :data:`PACKAGES` and of Python, and uavrl's commit, None outside of a checkout."""
    return provenance.versions(PACKAGES)


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
