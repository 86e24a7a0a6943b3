"""Sizes that no memory holds are refused before any of it is taken."""

import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError

FRAME = 200  # bytes of a stored transition: 32 faces, altitude, two angles, an action, reward and flags
VEHICLE = 3.5e6  # bytes: its scans on their way to the faces, and its body
COPIES = 4 * 6  # bytes of a weight: online, target, gradient, two moments of Adam, and one on the way
BATCHES = 32  # drawn at once, each with the states before and after
CGROUP = Path("/sys/fs/cgroup/memory.max")  # what a container may take, on Linux
GIGABYTE = 1e9


def require_memory(settings: TrainConfig, memory: float | None = None) -> None:
    """Refuses a training whose largest parts alone this machine's memory cannot hold."""
    uavs, state = settings.env.get("num_uavs", 1), FRAME * settings.perception.get("frames", 1)
    hidden, batch, capacity = settings.algo.hidden, settings.algo.batch_size, settings.buffer.get("capacity", 0)
    parts = {
        f"env.num_uavs={uavs}": uavs * settings.collector.get("processes", 1) * VEHICLE,
        f"buffer.capacity={capacity}": capacity * FRAME,
        f"algo.hidden={list(hidden)}": 3 * COPIES * _weights([state // 4, *hidden]),
        f"algo.batch_size={batch}": batch * (BATCHES * 2 * state + 3 * 4 * sum(hidden)),
    }
    for key in {"capacity", "batch_size"} & set(settings.lifeguard):
        parts[f"lifeguard.{key}={settings.lifeguard[key]}"] = settings.lifeguard[key] * FRAME
    for name, network in settings.fork.items():
        if isinstance(network, Mapping) and "hidden" in network:
            widths = list(network["hidden"])
            parts[f"fork.{name!s}.hidden={widths}"] = COPIES * _weights([state // 4, *widths])
    memory = machine_memory() if memory is None else memory
    if (total := sum(parts.values())) > memory:
        part = max(parts, key=lambda name: parts[name])
        raise UavrlError(
            f"This training needs about {total / GIGABYTE:,.0f} GB of memory, {parts[part] / GIGABYTE:,.0f} GB of it "
            f"for {part}, and this machine has {memory / GIGABYTE:,.0f} GB: lower {part.partition('=')[0]}."
        )


def machine_memory() -> float:
    """Bytes of memory that a process may take here: the machine's, or the container's where that is less."""
    memory = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if CGROUP.is_file() and (limit := CGROUP.read_text(encoding="utf-8").strip()).isdigit():
        memory = min(memory, float(limit))
    return memory


def _weights(widths: Sequence[int]) -> float:
    return float(sum((before + 1) * after for before, after in pairwise(widths)))
