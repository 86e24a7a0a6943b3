"""Typed configuration dataclasses and their registration with Hydra."""

from uavrl.configs.evaluate import EvaluateConfig
from uavrl.configs.registry import conf_dir, learner, register_schemas, to_dataclass
from uavrl.configs.train import TrainConfig

__all__ = ["EvaluateConfig", "TrainConfig", "conf_dir", "learner", "register_schemas", "to_dataclass"]
