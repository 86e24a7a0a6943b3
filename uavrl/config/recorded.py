"""What runs of an older uavrl have recorded otherwise than this one would."""

import logging
from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uavrl.config.build import TARGET
from uavrl.config.context import CONTEXT, context_of
from uavrl.errors import UavrlError

log = logging.getLogger(__name__)
# Where a class lies today, by the name that it was recorded under.
MOVED = {
    "uavrl.flying.baselines.VectorFieldHistogram": "uavrl.policies.baselines.VectorFieldHistogram",
    "uavrl.training.async_collector.AsyncCollector": "uavrl.collectors.async_.AsyncCollector",
    "uavrl.training.ray_collector.RayCollector": "uavrl.collectors.ray.RayCollector",
    "uavrl.training.sync_collector.SyncCollector": "uavrl.collectors.sync.SyncCollector",
}
# Keys that there are no longer, with the value that is today's only behaviour; None where no value bears on it.
GONE: Mapping[str, Any] = {
    "env.goal_angle": "elevation",
    "reward.time_cost": 0.0,
    "fork.variant": "fork",
    "backward_reward.scale": "rank",
    "backward_reward.window": None,  # of scale=centred
}


def renewed(config: DictConfig) -> DictConfig:
    """The configuration of a run as it would be recorded today.

    Raises:
        UavrlError: where another behaviour was recorded than there is today.
    """
    result = config.copy()
    OmegaConf.set_struct(result, False)
    for key, today in GONE.items():
        group, _, name = key.partition(".")
        part = result.get(group)
        if isinstance(part, DictConfig) and name in part and str(part.get(TARGET)).startswith("uavrl."):
            if today is not None and part[name] != today:
                raise UavrlError(
                    f"The run was flown with {key}={part[name]}, which there no longer is: use the uavrl that flew it; "
                    f"its summary.json tells the commit."
                )
            del part[name]
    for name in map(str, list(result)):
        _renew(result[name], name)
    if OmegaConf.select(result, "trainer.matmul") == "bf16":
        result.trainer.matmul = "mkl"
    return result


def _renew(part: Any, key: str) -> None:
    """Names the class of a part as it is called today, and leaves out what a run recorded there and never used."""
    if not isinstance(part, DictConfig) or TARGET not in part:
        return
    part[TARGET] = MOVED.get(str(part[TARGET]), part[TARGET])
    for name in map(str, list(part)):
        if name in context_of(key) and key.partition(".")[0] in CONTEXT:
            log.warning("%s.%s in the run's configuration was never used: it is left out.", key, name)
            del part[name]
        else:
            _renew(part[name], f"{key}.{name}")
