"""From yaml to objects: what a command line composes, validated, and the classes that it names."""

from uavrl.config.settings import EvaluateConfig, TrainConfig
from uavrl.config.validation import resolve, validate
from uavrl.config.yaml_files import compose, conf_dir, learner_name

__all__ = [
    "EvaluateConfig",
    "TrainConfig",
    "compose",
    "conf_dir",
    "learner_name",
    "resolve",
    "validate",
]
