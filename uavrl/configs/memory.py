"""How much memory a training takes, told before any of it is taken."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from uavrl.configs.algo import SACConfig, TD3Config
from uavrl.configs.buffer import ABRConfig, PrioritizedBufferConfig
from uavrl.configs.train import TrainConfig
from uavrl.configs.valley import EnvConfig
from uavrl.errors import UavrlError

NUMBER = 4  # bytes of a float32
VEHICLE = 3.5e6  # bytes: its scans on their way to the faces, and its body
COPIES = 6  # of a network's weights: online, target, gradient, two moments of Adam, and one on the way
BATCHES = 32  # drawn at once
CGROUP = Path("/sys/fs/cgroup/memory.max")  # what a container may take, on Linux
GIGABYTE = 1e9


def bytes_needed(settings: TrainConfig) -> dict[str, float]:
    """An estimate of what a training takes, by the key that decides most of it.

    Examples:
        >>> from uavrl.configs.algo import TD3Config
        >>> from uavrl.configs.buffer import NoBackwardRewardConfig, UniformBufferConfig
        >>> from uavrl.configs.valley import PerceptionConfig, TraditionalRewardConfig
        >>> config = TrainConfig(EnvConfig(), PerceptionConfig(), TraditionalRewardConfig(), TD3Config(),
        ...     UniformBufferConfig(), NoBackwardRewardConfig())
        >>> {key: round(value / 1e6) for key, value in bytes_needed(config).items() if value > 1e6}
        {'env.num_uavs': 28, 'buffer.capacity': 191, 'algo.hidden': 15, 'algo.batch_size': 4}
    """
    algo, buffer, uavs = settings.algo, settings.buffer, getattr(settings.env, "num_uavs", 1)
    valley = isinstance(settings.env, EnvConfig)
    frame, frames = (35, settings.perception.frames) if valley else (24, 1)
    state, actions = frame * frames, 4
    critics = 2 if isinstance(algo, (TD3Config, SACConfig)) else 1
    widths = [("algo.hidden", algo.hidden, 1 + critics)]
    if algo.fork is not None:
        widths += [("algo.fork.system_hidden", algo.fork.system_hidden, 1)]
        widths += [("algo.fork.reward_hidden", algo.fork.reward_hidden, 1)]
    hidden_values = 4 * sum(sum(hidden) for _, hidden, _ in widths)  # of one transition, with their gradients
    kept = frame * 17 / 16 if algo.n_steps == 1 else 2 * state * 9 / 8  # both states whole: they share no frames
    transition = kept * NUMBER + 42
    parts = {
        "env.num_uavs": uavs * settings.collector.processes * VEHICLE * valley,
        "buffer.capacity": buffer.capacity * (transition + 32 * isinstance(buffer, PrioritizedBufferConfig)),
        "collector.steps_per_batch": 3 * settings.collector.steps_per_batch * uavs * 2 * state * NUMBER,
        **{key: COPIES * NUMBER * nets * _weights([2 * state + actions, *w, 1]) for key, w, nets in widths},
        "algo.batch_size": algo.batch_size * NUMBER * (BATCHES * (2 * state + 10) + hidden_values),
    }
    if algo.lifeguard is not None:
        parts["algo.lifeguard.capacity"] = algo.lifeguard.capacity * (frame + actions) * NUMBER
        parts["algo.lifeguard.batch_size"] = 4 * algo.lifeguard.batch_size * (frame + actions) * NUMBER
    if isinstance(settings.backward_reward, ABRConfig):
        parts["backward_reward.max_classes"] = 2 * settings.backward_reward.max_classes * 10 * frames * NUMBER
    return parts


def require_memory(settings: TrainConfig, memory: float | None = None) -> None:
    """Refuses a training that this machine's memory cannot hold.

    Args:
        settings: the training.
        memory: bytes of memory; the machine's if None.

    Raises:
        UavrlError: naming the key that takes most.
    """
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
    if CGROUP.is_file() and (limit := CGROUP.read_text().strip()).isdigit():
        memory = min(memory, float(limit))
    return memory


def _weights(widths: Sequence[int]) -> float:
    return float(sum((before + 1) * after for before, after in pairwise(widths)))


def _value(settings: Any, key: str) -> Any:
    for name in key.split("."):
        settings = getattr(settings, name)
    return list(settings) if isinstance(settings, tuple) else settings
