"""Keys that runs of an older uavrl have recorded, and that there are no longer."""

from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig

from uavrl.configs.offered import TARGET
from uavrl.errors import UavrlError

# With the value that is today's only behaviour; None where no value bears on it any more.
GONE: Mapping[str, Any] = {
    "env.goal_angle": "elevation",
    "reward.time_cost": 0.0,
    "fork.variant": "fork",
    "backward_reward.scale": "rank",
    "backward_reward.window": None,  # of scale=centred
}


def without_gone(config: DictConfig) -> DictConfig:
    """The configuration of a run without these keys.

    Raises:
        UavrlError: where another behaviour was recorded than today's.
    """
    result = config.copy()
    for key, today in GONE.items():
        group, _, name = key.partition(".")
        part = result.get(group)
        if not isinstance(part, DictConfig) or name not in part or not str(part.get(TARGET)).startswith("uavrl."):
            continue
        if today is not None and part[name] != today:
            raise UavrlError(
                f"The run was flown with {key}={part[name]}, which there no longer is: use the uavrl that flew it; its "
                f"summary.json tells the commit."
            )
        del part[name]
    return result
