"""From what Hydra composed, or a run has written, to validated settings."""

from dataclasses import MISSING, fields
from typing import Any, TypeVar, cast, get_type_hints, overload

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from uavrl.config.build import TARGET
from uavrl.config.parts import PARTS, validated_parts
from uavrl.config.settings import TrainConfig
from uavrl.errors import UavrlError
from uavrl_onboard.sentences import require_known
from uavrl_onboard.values import to_plain, validated

T = TypeVar("T")


@overload
def validate(config: DictConfig) -> TrainConfig: ...
@overload
def validate(config: DictConfig, kind: type[T]) -> T: ...
def validate(config: DictConfig, kind: type[Any] = TrainConfig) -> Any:
    """Resolves a configuration and validates all its values, without making anything of them.

    Args:
        config: composed by Hydra, or the ``config.yaml`` of a run.
        kind: the dataclass of its settings.

    Raises:
        UavrlError: naming the key that is unknown, missing, of another type or out of range.
    """
    values = _plain_values(config)
    hints = get_type_hints(kind, include_extras=True)
    require_known(values, hints, "")
    for each in fields(kind):
        if each.default is each.default_factory is MISSING and each.name not in values:
            raise UavrlError(f"{each.name} is not in the configuration: choose one with {each.name}=NAME.")
    # An environment first: others take values over from it, and its key is the one that was given.
    parts = {name: values[name] for name in sorted(PARTS, key=lambda name: name != "env") if name in values}
    others = validated({name: value for name, value in values.items() if name not in parts}, hints)
    return kind(**others, **validated_parts(parts, others.get("packages", ())))


def resolve(config: DictConfig) -> DictConfig:
    """The same configuration with every value worked out, and as its class has it: what ``config.yaml`` holds."""
    return to_config(validate(config))


def to_config(settings: Any) -> DictConfig:
    """The configuration that :func:`validate` would read these settings from."""
    plain = to_plain(settings)
    for name in PARTS:
        for key, value in (getattr(settings, name, None) or {}).items():
            if getattr(value, "NAMED", False):  # settings whose class a file has to name
                plain[name][key] = {TARGET: f"{type(value).__module__}.{type(value).__qualname__}", **plain[name][key]}
    return OmegaConf.create(plain)


def _plain_values(config: DictConfig) -> dict[str, Any]:
    try:
        return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True, throw_on_missing=True))
    except UavrlError:
        raise
    except MissingMandatoryValue as error:
        key = error.full_key
        raise UavrlError(f"{key} must be given, and is not: add {key}=VALUE.") from error
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        place = getattr(error, "full_key", None)
        where, reason = f" at {place}" if place else "", str(error).splitlines()[0]
        raise UavrlError(f"The configuration does not hold together{where}: {reason}") from error
