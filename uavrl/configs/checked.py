"""From what Hydra composed, or a run has written, to checked settings."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeVar, cast, get_type_hints

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.configs.offered import without_offered
from uavrl.configs.parts import PARTS, TARGET, checked_parts
from uavrl.configs.parts import plain as plain_values
from uavrl.configs.recorded import without_gone
from uavrl.configs.train import TrainConfig
from uavrl.configs.typed import require_known, typed
from uavrl.errors import UavrlError

T = TypeVar("T")


def to_dataclass(config: DictConfig) -> TrainConfig:
    """The settings of a training: see :func:`checked`."""
    return checked(config, TrainConfig)


def settings_of_run(config: DictConfig) -> TrainConfig:
    """The settings that a run has recorded; products in bfloat16, which there are no longer, become float32."""
    recorded = without_gone(without_offered(config))
    if OmegaConf.select(recorded, "trainer.products") == "bf16":
        recorded.trainer.products = "mkl"
    return to_dataclass(recorded)


def checked(config: DictConfig, kind: type[T]) -> T:
    """Resolves a configuration and checks all its values; parts stay configurations, which ``build`` makes objects of.

    Args:
        config: composed by Hydra, or the ``config.yaml`` of a run.
        kind: the dataclass of its settings.

    Raises:
        UavrlError: naming the key that is unknown, missing, of another type or out of range.
    """
    values = _resolved(config)
    if isinstance(values.get("algo"), Mapping) and TARGET not in values["algo"]:
        raise UavrlError("The configuration is of an older uavrl, which named no classes: start a new run.")
    hints = get_type_hints(kind, include_extras=True)
    require_known(values, hints, "")
    missing = [field.name for field in fields(cast(Any, kind)) if field.default is field.default_factory is MISSING]
    for name in missing:
        if name not in values:
            raise UavrlError(f"{name} is not in the configuration: choose one with {name}=NAME.")
    packages = typed(values.get("packages", []), tuple[str, ...], "packages")
    parts = checked_parts({name: values[name] for name in PARTS if name in values and name in hints}, packages)
    others = {name: typed(value, hints[name], name) for name, value in values.items() if name not in parts}
    return kind(**{name: OmegaConf.create(part) for name, part in parts.items()}, **others)


def complete(config: DictConfig) -> DictConfig:
    """The same configuration with every value worked out, and as its class has it: what ``config.yaml`` holds."""
    settings = to_dataclass(config)
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    parts = {name: value for name, value in values.items() if isinstance(value, DictConfig)}
    return OmegaConf.create(plain_values({name: value for name, value in values.items() if name not in parts}) | parts)


def _resolved(config: DictConfig) -> dict[str, Any]:
    try:
        return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True, throw_on_missing=True))
    except UavrlError:
        raise
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        place = getattr(error, "full_key", None)
        where, reason = f" at {place}" if place else "", str(error).splitlines()[0]
        raise UavrlError(f"The configuration does not hold together{where}: {reason}") from error
