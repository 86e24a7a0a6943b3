"""What the benchmarks share: the default experiment, and on what machine they run."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from uavrl.configs import TrainConfig, compose, to_dataclass


def experiment(*overrides: str) -> TrainConfig:
    """Returns the checked configuration of `uavrl-train OVERRIDES`."""
    return to_dataclass(compose(*overrides))


def machine() -> dict[str, Any]:
    """Returns the processor and the versions that decide the speed."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    packages = ("torch", "torchrl", "pybullet", "embreex", "numpy")
    return {
        "cpu": models[0] if models else platform.processor(),
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
