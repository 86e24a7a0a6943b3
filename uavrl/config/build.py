"""From a part of a configuration to the object: the one place where a name in a file becomes a class."""

import inspect
from collections.abc import Iterable, Mapping
from importlib import import_module
from types import SimpleNamespace
from typing import Any, TypeVar, get_type_hints

from uavrl.config.context import refuse_context, to_networks
from uavrl.errors import MissingExtra, UavrlError
from uavrl_onboard.sentences import below, did_you_mean

T = TypeVar("T")
TARGET = "_target_"  # the key that names a class; null where the part is left out
# What any configuration may name: not all of TorchRL, some of which starts commands or unpickles what it is told.
ALLOWED = (
    "uavrl",
    "torchrl.record.loggers.csv",
    "torchrl.record.loggers.tensorboard",
    "torchrl.modules.models.models",
)


def require_allowed(target: str, packages: Iterable[str], key: str = TARGET) -> None:
    """Refuses a class that is neither ours nor of a package that the user lists: what a file names is imported.

    A name is of identifiers alone: ``uavrl./their/folder.X`` would have a file outside of uavrl read, and run.
    """
    top, *others = target.split(".")
    if others and not all(name.isidentifier() for name in target.split(".")):
        raise UavrlError(f"{key} names {target}, which is no name of a class: write PACKAGE.MODULE.CLASS.")
    if not any(target.startswith(f"{package}.") for package in (*ALLOWED, *packages)):
        raise UavrlError(
            f"{key} names {target}, and {top} is no package that you have listed: if you trust its code, add "
            f"packages=[{top}] to the command."
        )


def find_class(target: str, kind: type[T], packages: Iterable[str] = (), key: str = TARGET) -> type[T]:
    """The class of a name, found to be allowed and of the right kind."""
    packages = tuple(packages)
    require_allowed(target, packages, key)
    module, _, name = target.rpartition(".")
    try:
        holder = import_module(module)
        found = getattr(holder, name)
    except MissingExtra:
        raise
    except ImportError as error:
        reason = "check the name, and that its folder is on PYTHONPATH or its package installed"
        raise UavrlError(f"{key}: there is no class {target} ({error}): {reason}.") from error
    except AttributeError as error:
        known = [other for other in vars(holder) if other[:1].isupper()]
        near = did_you_mean(name, known, ": ", "check the name.")
        raise UavrlError(f"{key}: there is no class {target}{near}") from error
    if not isinstance(found, type):
        raise UavrlError(f"{key}: there is no class {target}, which is {found!r:.80}: name a class.")
    if not issubclass(found, kind):
        raise UavrlError(f"{key}: {target} must be a {kind.__name__}, got {found!r}: name a class of that kind.")
    require_allowed(f"{found.__module__}.{name}", packages, key)  # where it is defined, whatever else imports it
    return found


def arguments(kind: type) -> Mapping[str, Any]:
    """The arguments that a class takes by name, with their types.

    A constructor with ``**kwargs`` also takes what the next one takes, in the order of the class's bases.
    """
    found: dict[str, Any] = {}
    for base in kind.__mro__[:-1]:
        if "__init__" not in vars(base):
            continue
        init = inspect.unwrap(vars(base)["__init__"])
        parameters = list(inspect.signature(init).parameters.values())[1:]
        named = [each for each in parameters if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
        found = {each.name: _hint(each, init) for each in named} | found
        if not any(each.kind is each.VAR_KEYWORD for each in parameters):
            break
    return found


def _hint(parameter: inspect.Parameter, init: Any) -> Any:
    """The type of an argument; any where none is told, or one that cannot be found out."""
    if parameter.annotation is parameter.empty:
        return Any
    annotated: Any = SimpleNamespace(__annotations__={parameter.name: parameter.annotation})
    try:
        return get_type_hints(annotated, init.__globals__, include_extras=True)[parameter.name]
    except (NameError, TypeError, SyntaxError):
        return Any


def build(
    part: Mapping[str, Any], kind: type[T], *, packages: Iterable[str] = (), key: str = "", **context: Any
) -> T | None:
    """Makes what a part names; None where it names nothing.

    Args:
        part: the class, and validated values that its constructor takes.
        kind: what the class must be.
        packages: that the user trusts.
        key: of the part, where the class speaks of its arguments by their names.
        **context: what the run hands to the constructor where that names it (:data:`uavrl.config.context.CONTEXT`).
    """
    if part[TARGET] is None:
        return None
    made = find_class(part[TARGET], kind, packages)
    written = options(part, packages, **context)
    refuse_context(key or part[TARGET], written, context)
    try:
        return made(**written, **{name: value for name, value in context.items() if name in arguments(made)})
    except UavrlError as error:
        if not key:
            raise
        raise UavrlError(below(key, str(error), arguments(made))) from error
    except (ValueError, TypeError) as error:
        raise UavrlError(f"{part[TARGET]} cannot be made: {error}") from error


def options(part: Mapping[str, Any], packages: Iterable[str] = (), **context: Any) -> dict[str, Any]:
    """What the constructor of a part's class takes of the part's own keys, with parts of parts made."""
    from torch import nn

    known = arguments(find_class(part[TARGET], object, packages))
    found = {name: value for name, value in part.items() if name in known}
    handed_on = {name: context[name] for name in to_networks(context)}
    return {
        name: build(value, nn.Module, packages=packages, **handed_on) if is_part(value) else value
        for name, value in found.items()
    }


def is_part(value: Any) -> bool:
    """Whether a value names a class."""
    return isinstance(value, Mapping) and TARGET in value
