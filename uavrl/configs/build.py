"""From a part of a configuration to the object: the one place where a name in a file becomes a class."""

from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any, TypeVar

from uavrl.configs.offered import refuse_offered, to_networks
from uavrl.configs.parts import TARGET, require_allowed
from uavrl.configs.signature import signature
from uavrl.configs.typed import below, typed
from uavrl.errors import UavrlError

T = TypeVar("T")


def resolve(target: str, kind: type[T], packages: Iterable[str] = ()) -> type[T]:
    """The class of a name, found to be allowed and of the right kind."""
    packages = tuple(packages)
    require_allowed(target, packages)
    module, _, name = target.rpartition(".")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise UavrlError(f"{target} cannot be imported ({error}): check the name, and that it is installed.") from error
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise UavrlError(f"{target} must be a {kind.__name__}, got {found!r}: name a class of that kind.")
    require_allowed(f"{found.__module__}.{name}", packages)  # where it is defined, whatever else imports it
    return found


def build(
    part: Mapping[str, Any], kind: type[T], *, packages: Iterable[str] = (), key: str = "", **offered: Any
) -> T | None:
    """Makes what a part names; None where it names nothing.

    Args:
        part: the class, and values that its constructor takes.
        kind: what the class must be.
        packages: that the user trusts.
        key: of the part, where the class speaks of its arguments by their names.
        **offered: what the run hands to the constructor where that names it (:data:`uavrl.configs.offered.OFFERED`).
    """
    if part[TARGET] is None:
        return None
    made = resolve(part[TARGET], kind, packages)
    hints = signature(part[TARGET]) or {}
    written = options(part, packages, **offered)
    refuse_offered(key or part[TARGET], written, offered)
    try:
        return made(**written, **{name: value for name, value in offered.items() if name in hints})
    except UavrlError as error:
        if not key:
            raise
        raise UavrlError(below(key, str(error), hints)) from error
    except (ValueError, TypeError) as error:
        raise UavrlError(f"{part[TARGET]} cannot be made: {error}") from error


def options(part: Mapping[str, Any], packages: Iterable[str] = (), **offered: Any) -> dict[str, Any]:
    """What the constructor of a part's class takes of the part's own keys, with parts of parts made."""
    from torch import nn

    hints = signature(part[TARGET]) or {}
    found: dict[str, Any] = {}
    for name, value in part.items():
        if name in hints and isinstance(value, Mapping) and TARGET in value:
            handed_on = {name: offered[name] for name in to_networks(offered)}
            found[name] = build(value, nn.Module, packages=packages, **handed_on)
        elif name in hints:
            found[name] = typed(plain_data(value), hints[name], str(name))
    return found


def plain_data(value: Any) -> Any:
    """A node of a configuration as plain data."""
    from omegaconf import Container, OmegaConf

    return OmegaConf.to_container(value, resolve=True) if isinstance(value, Container) else value
