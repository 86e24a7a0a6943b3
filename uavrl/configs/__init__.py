"""Checked settings, and what makes objects of them."""

from uavrl.configs.checked import checked, complete, settings_of_run, to_dataclass
from uavrl.configs.evaluate import EvaluateConfig
from uavrl.configs.registry import compose, conf_dir, learner_name, register_resolvers
from uavrl.configs.train import TrainConfig

__all__ = [
    "EvaluateConfig",
    "TrainConfig",
    "checked",
    "complete",
    "compose",
    "conf_dir",
    "learner_name",
    "register_resolvers",
    "settings_of_run",
    "to_dataclass",
]
