"""How much memory a training takes, told before any of it is taken."""

import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError

NUMBER = 4  # bytes of a float32
VEHICLE = 3.5e6  # bytes: its scans on their way to the faces, and its body
COPIES = 6  # of a network's weights: online, target, gradient, two moments of Adam, and one on the way
BATCHES = 32  # drawn at once
CGROUP = Path("/sys/fs/cgroup/memory.max")  # what a container may take, on Linux
GIGABYTE = 1e9


def bytes_needed(settings: TrainConfig) -> dict[str, float]:
    """An estimate of what a training takes, by the key that decides most of it: of two critics, in a valley."""
    uavs, frames = settings.env.get("num_uavs", 1), settings.perception.get("frames", 1)
    actions = 4
    cells = 72 if settings.perception.get("reduction") == "range_image" else 32
    frame = cells + 3 + actions * settings.perception.get("last_action", False)
    state, batch, capacity = frame * frames, settings.algo.batch_size, settings.buffer.get("capacity", 0)
    widths = {"algo.hidden": (settings.algo.hidden, 3)}
    for name, part in settings.fork.items():
        if isinstance(part, Mapping) and "hidden" in part:
            widths[f"fork.{name!s}.hidden"] = (part["hidden"], 1)
    hidden_values = 4 * sum(sum(hidden) for hidden, _ in widths.values())  # of one transition, with their gradients
    kept = frame * 17 / 16 if settings.algo.n_steps == 1 else 2 * state * 9 / 8  # both states whole: they share none
    transition = (kept + actions * settings.guided) * NUMBER + 42
    parts = {
        "env.num_uavs": uavs * _processes(settings) * VEHICLE,
        "buffer.capacity": capacity * (transition + 32 * ("alpha" in settings.buffer)),
        "collector.steps_per_batch": 3 * settings.collector.steps_per_batch * uavs * 2 * state * NUMBER,
        **{
            key: COPIES * NUMBER * nets * _weights([2 * state + actions, *hidden, 1])
            for key, (hidden, nets) in widths.items()
        },
        "algo.batch_size": batch * NUMBER * (BATCHES * (2 * state + 10) + hidden_values),
    }
    for key, each in (("capacity", 1), ("batch_size", 4)):
        if key in settings.lifeguard:
            parts[f"lifeguard.{key}"] = each * settings.lifeguard[key] * (frame + actions) * NUMBER
    if "max_classes" in settings.backward_reward:
        parts["backward_reward.max_classes"] = 2 * settings.backward_reward.max_classes * 10 * frames * NUMBER
    return parts


def _processes(settings: TrainConfig) -> int:
    """How many fly on this machine."""
    collector = settings.collector
    elsewhere = collector.get("address") is not None
    return 1 if elsewhere else collector.get("processes", collector.get("workers", 1))


def require_memory(settings: TrainConfig, memory: float | None = None) -> None:
    """Refuses a training that this machine's memory cannot hold."""
    parts = bytes_needed(settings)
    memory = machine_memory() if memory is None else memory
    if (total := sum(parts.values())) > memory:
        key = max(parts, key=lambda name: parts[name])
        raise UavrlError(
            f"This training needs about {total / GIGABYTE:,.0f} GB of memory, {parts[key] / GIGABYTE:,.0f} GB of it "
            f"for {key}={_value(settings, key)}, and this machine has {memory / GIGABYTE:,.0f} GB: lower {key}."
        )


def machine_memory() -> float:
    """Bytes of memory that a process may take here: the machine's, or the container's where that is less."""
    memory = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if CGROUP.is_file() and (limit := CGROUP.read_text(encoding="utf-8").strip()).isdigit():
        memory = min(memory, float(limit))
    return memory


def _weights(widths: Sequence[int]) -> float:
    return float(sum((before + 1) * after for before, after in pairwise(widths)))


def _value(settings: Any, key: str) -> Any:
    for name in key.split("."):
        settings = getattr(settings, name)
    return settings
