"""The parts of a run: each names its class, and holds what its constructor takes."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from typing import Annotated, Any, get_type_hints

from uavrl.configs.checks import did_you_mean, require
from uavrl.configs.offered import OFFERED, TARGET, offered_to, refuse_offered
from uavrl.configs.signature import classes, signature
from uavrl.configs.typed import require_known, typed
from uavrl.errors import UavrlError
from uavrl.ranges import Count, NonNegative, Range, Whole, Widths

PARTS = (
    "perception",
    "reward",
    "algo",
    "fork",
    "lifeguard",
    "enhancer",
    "buffer",
    "backward_reward",
    "guide",
    "env",
    "collector",
    "logger",
)
# What any configuration may name: not all of TorchRL, some of which starts commands or unpickles what it is told.
ALLOWED = (
    "uavrl",
    "torchrl.record.loggers.csv",
    "torchrl.record.loggers.tensorboard",
    "torchrl.modules.models.models",
)


# What is a part is checked as one, and comes to no range.
Network = Annotated[Any, Range(f"a part with a {TARGET}", lambda value: False)]


@dataclass
class Learning:
    """What the loop itself reads of ``algo``."""

    batch_size: Count
    random_steps: Whole
    exploration_noise: NonNegative
    exploration_spread: Annotated[float, Range("at least 1", lambda value: value >= 1)]
    hidden: Widths
    layer_norm: bool
    n_steps: Count
    actor: Network
    critic: Network


@dataclass
class Collecting:
    """What the loop itself reads of ``collector``."""

    steps_per_batch: Count


@dataclass
class Storing:
    """What the loop itself reads of ``buffer``."""

    mirror: bool


@dataclass
class Logging:
    """What the loop itself reads of ``logger``."""

    interval: Count


_LOOP = {"algo": Learning, "buffer": Storing, "collector": Collecting, "logger": Logging}
STEPPER = "uavrl.training.update.ActorCriticStepper"  # takes its part of algo
TO_STEPPER = ("loss", "execution")  # what the run hands to it


def checked_parts(parts: Mapping[str, Any], packages: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The parts of a run with every value as its class has it, found to be known, of its type and in its range."""
    packages = tuple(packages)
    taken = _taken_beside(parts, packages)
    return {name: _checked(part, name, packages, taken.get(name, {})) for name, part in parts.items()}


def names_taken(parts: Mapping[str, Any], key: str, packages: Iterable[str]) -> set[str]:
    """The names that can be written below a key, such as ``reward`` or ``algo.actor``."""
    packages, part = tuple(packages), parts
    for name in key.split("."):
        part = part.get(name, {}) if isinstance(part, Mapping) else {}
    target = part.get(TARGET) if isinstance(part, Mapping) else None
    own = {} if target is None else _signature(str(target), f"{key}.{TARGET}", packages)
    return {*_without(offered_to(key), own), *_taken_beside(parts, packages).get(key, {})}


def _taken_beside(parts: Mapping[str, Any], packages: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """What the keys of a part mean to others than its class, with their types.

    A key of ``algo`` goes to the loss, to the optimisation step or to the loop, one of ``perception`` to the transform
    or to the environment: whichever takes it.
    """
    taken: dict[str, dict[str, Any]] = {
        name: get_type_hints(reader, include_extras=True) for name, reader in _LOOP.items()
    }
    taken["algo"].update(_without(TO_STEPPER, signature(STEPPER) or {}))
    env = parts.get("env")
    if isinstance(env, Mapping) and env.get(TARGET) is not None:
        hints = _signature(str(env[TARGET]), f"env.{TARGET}", packages)
        taken["perception"] = _without(OFFERED["env"], hints)
        _require_one_place(parts.get("perception"), env, hints)
    return taken


def _without(names: Iterable[str], hints: Mapping[str, Any]) -> dict[str, Any]:
    return {name: hint for name, hint in hints.items() if name not in names}


def _require_one_place(perception: Any, env: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    """Refuses what both parts hold for the environment: one of the two values would not be used."""
    if not isinstance(perception, Mapping) or TARGET not in perception:
        return
    own = signature(str(perception[TARGET])) or {}
    for name in map(str, perception):
        if name != TARGET and name in env and name in hints and name not in own:
            raise UavrlError(f"perception.{name} and env.{name} are the same value: leave one of the two out.")


def _checked(part: Any, key: str, packages: tuple[str, ...], beside: Mapping[str, Any]) -> dict[str, Any]:
    require(isinstance(part, Mapping) and TARGET in part, key, f"a part with a {TARGET}", part)
    options = {str(name): value for name, value in part.items() if name != TARGET}
    if part[TARGET] is None:
        require_known(options, beside, key)
        return {TARGET: None, **options}
    hints = _signature(str(part[TARGET]), f"{key}.{TARGET}", packages)
    refuse_offered(key, [name for name in options if name in hints], offered_to(key))
    require_known(options, {**beside, **hints}, key)
    for name, value in options.items():
        below = f"{key}.{name}"
        if isinstance(value, Mapping) and TARGET in value:
            options[name] = _checked(value, below, packages, {})
        else:
            options[name] = plain(typed(value, hints.get(name, beside.get(name)), below))
    return {TARGET: part[TARGET], **options}


def _signature(target: str, key: str, packages: tuple[str, ...]) -> Mapping[str, Any]:
    require_allowed(target, packages, key)
    hints = signature(target)
    if hints is None:
        module, _, name = target.rpartition(".")
        check = "check the name, and that its folder is on PYTHONPATH or its package installed."
        raise UavrlError(f"{key}: there is no class {target}{did_you_mean(name, classes(module), ': ', check)}")
    return hints


def require_allowed(target: str, packages: Iterable[str], key: str = TARGET) -> None:
    """Refuses a class that is neither ours nor of a package that the user lists: what a file names is imported.

    A name is of identifiers alone: ``uavrl./their/folder.X`` would have a file outside of uavrl read, and run.
    """
    allowed = (*ALLOWED, *packages)
    top, *below = target.split(".")
    if below and not target.replace(".", "").isidentifier():
        raise UavrlError(f"{key} names {target}, which is no name of a class: write PACKAGE.MODULE.CLASS.")
    if not any(target.startswith(f"{package}.") for package in allowed):
        raise UavrlError(
            f"{key} names {target}, and {top} is no package that you have listed: if you trust its code, add "
            f"packages=[{top}] to the command."
        )


def plain(value: Any) -> Any:
    """Dataclasses as mappings and tuples as lists, as yaml has them."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(name): plain(child) for name, child in value.items()}
    return [plain(child) for child in value] if isinstance(value, list | tuple) else value
