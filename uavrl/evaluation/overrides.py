"""What overrides may change where a trained policy flies, and the names of results that they give."""

import hashlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uavrl.config.build import TARGET, arguments, find_class
from uavrl.errors import UavrlError
from uavrl.runs.names import LONGEST_NAME

# What may be changed for a trained policy, and blind_to: it reads the same numbers, of another sensor or another goal.
OF_SENSOR = ("perception.lidar.", "perception.blind")
# Keys of an evaluation that do not say which policy was evaluated in which tasks.
PLAIN_KEYS = ("run", "packages", "episodes", "output", "device", "threads", "matmul", "processes", "progress")


def require_valley(env: Mapping[str, Any], choices: Mapping[str, str], key: str) -> None:
    """Refuses a key that another environment has no use for."""
    if "world" not in env:
        raise UavrlError(f"{key} is for the valley, and the environment is {choices.get('env')}: leave {key} out.")


def with_overrides(run_config: DictConfig, composed: DictConfig, overrides: list[str]) -> DictConfig:
    """The run's configuration with what the command line says about environment and sensor.

    ``env=NAME`` replaces the environment, but for its sensor and its speed, and ``randomize=NAME`` all of
    ``env.randomize``; ``env.key=value``, ``perception.lidar.key=value``, ``perception.blind=value`` and
    ``perception.blind_to=value`` change one value. The rest of perception makes the policy's input: it stays.
    """
    result = run_config.copy()
    result.packages = composed.packages  # whom the one trusts who runs this, whatever the file says
    keys = keys_of(overrides)
    if "env" in keys:
        limit = OmegaConf.select(result, "env.max_speed")
        result.env = composed.env  # whose lidar is null: the run's sensor stays
        if limit is not None and "max_speed" in result.env and "env.max_speed" not in keys:
            result.env.max_speed = limit
        result.choices.env = composed.choices.env
        _require_env_of_policy(result)
    if "randomize" in keys:
        require_valley(result.env, result.choices, "randomize")
        result.env.randomize = composed.env.randomize
    require_sensor_alone(keys, ("perception", "reward"), "run")
    for key in keys:
        if key.startswith(("env.", *OF_SENSOR)):
            OmegaConf.update(result, key, OmegaConf.select(composed, key), merge=False)
    return result


def require_sensor_alone(keys: Iterable[str], groups: Collection[str], owner: str) -> None:
    """Refuses what makes the inputs of a trained policy, or has trained it; its sensor may be another."""
    for key in keys:
        if key.split(".")[0] in groups and not key.startswith(OF_SENSOR):
            told = "cannot change where its policy is evaluated: leave it out."
            raise UavrlError(f"{key} belongs to the {owner} and {told}")


def keys_of(overrides: Iterable[str]) -> list[str]:
    """Return the key of each override."""
    return [override.split("=", 1)[0] for override in overrides]


def result_overrides(overrides: Sequence[str], plain: Collection[str] = PLAIN_KEYS) -> list[str]:
    """Return the overrides whose keys are not ``plain``, which distinguish a result from others."""
    return [override for override in overrides if override.split("=")[0] not in plain]


def output_name(stem: str, overrides: Sequence[str]) -> str:
    """Return a file name without suffix that contains the overrides."""
    told = [re.sub(r"[^\w.=-]+", "-", override).replace("=-", "=").strip("-") for override in overrides]
    name = "_".join([stem, *told])
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def _require_env_of_policy(run: DictConfig) -> None:
    """Refuses an environment that takes less than the policy's perception says."""
    targets = (str(part[TARGET]) for part in (run.perception, run.env) if part[TARGET])
    classes = [find_class(target, object, run.packages) for target in targets]
    taken = {TARGET, *(name for each in classes for name in arguments(each))}
    if not taken.issuperset(map(str, run.perception)):
        raise UavrlError(
            f"The policy and env={run.choices.env} do not go together: the policy reads what perception="
            f"{run.choices.perception} makes of another environment. Leave env out, or choose another policy."
        )
