"""The parts of a run: each names its class, and holds what its constructor takes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Annotated, Any, get_args

from pydantic import Field

from uavrl.config.build import TARGET, arguments, find_class, is_part, require_allowed
from uavrl.config.context import CONTEXT, context_of, refuse_context
from uavrl.errors import UavrlError
from uavrl_onboard.ranges import Count, NonNegative, Rule, Text, Whole, Widths
from uavrl_onboard.sentences import require, require_known
from uavrl_onboard.values import validated

PARTS = (
    "perception",
    "reward",
    "algo",
    "recurrent",
    "fork",
    "lifeguard",
    "actor_penalty",
    "smoothness",
    "cloning",
    "validation",
    "buffer",
    "backward_reward",
    "demonstrator",
    "env",
    "collector",
    "logger",
)
_NETWORK = Annotated[Any, Rule(f"a part with a {TARGET}", lambda value: False)]  # one is validated as a part
# What the loop itself reads of a part, beside its class.
LOOP: Mapping[str, Mapping[str, Any]] = {
    "algo": {
        "batch_size": Count,
        "learning_starts": Whole,
        "exploration_noise": NonNegative,
        "exploration_spread": Annotated[float, Field(ge=1, le=1e6)],
        "hidden": Widths,
        "layer_norm": bool,
        "critic_reads": Annotated[
            tuple[Text, ...], Rule("different names", lambda names: len(set(names)) == len(names))
        ],
        "n_steps": Annotated[int, Field(ge=1, le=10_000)],
        "actor": Annotated[Any, Rule(f"a part with a {TARGET}; recurrent=gru gives it a memory", lambda value: False)],
        "critic": _NETWORK,
    },
    "buffer": {"mirror": bool},
    "collector": {"steps_per_batch": Annotated[int, Field(ge=1, le=10_000)]},
    "logger": {"interval": Count},
}
STEPPER = "uavrl.training.update.ActorCriticStepper"  # takes its part of algo
TO_STEPPER = ("loss", "execution")  # what the run hands to it


class MissingValue(UavrlError, AttributeError):
    """A value is asked for that a part does not hold."""


class Part(dict[str, Any]):
    """The class of a part and its validated values, which are attributes, too.

    Examples:
        >>> Part(_target_="uavrl.losses.TD3Loss", gamma=0.99).gamma
        0.99
    """

    def __getattr__(self, name: str) -> Any:
        """A value by its name."""
        try:
            return self[name]
        except KeyError:
            raise MissingValue(f"The run needs {name}, which {self.get(TARGET)} is not given: add it.") from None


def validated_parts(parts: Mapping[str, Any], packages: Iterable[str]) -> dict[str, Part]:
    """The parts of a run with every value as its class has it, found to be known, of its type and in its range."""
    packages, parts = tuple(packages), _with_sensor(parts)
    for key, target in _targets(parts, ""):  # all of them, before anything is imported
        require_allowed(target, packages, key)
    extra = _extra_keys(parts, packages)
    return {name: _validated(part, name, packages, extra.get(name, {})) for name, part in parts.items()}


def _with_sensor(parts: Mapping[str, Any]) -> Mapping[str, Any]:
    """The parts with the sensor that ``env.lidar`` names, in ``perception.lidar``, which says how it is scanned."""
    env, perception = parts.get("env"), parts.get("perception")
    if not isinstance(env, Mapping) or "lidar" not in env or not isinstance(perception, Mapping):
        return parts
    if not isinstance(scanned := perception.get("lidar"), Mapping):
        return parts
    kept = {key: value for key, value in env.items() if key != "lidar"}
    named = {} if env["lidar"] is None else {"sensor": env["lidar"]}
    return {**parts, "env": kept, "perception": {**perception, "lidar": {**scanned, **named}}}


def _targets(node: Mapping[str, Any], above: str) -> Iterator[tuple[str, str]]:
    for name, value in node.items():
        if name == TARGET and value is not None:
            yield f"{above}{name}", str(value)
        elif isinstance(value, Mapping):
            yield from _targets(value, f"{above}{name}.")


def _extra_keys(parts: Mapping[str, Any], packages: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """What the keys of a part mean to others than its class, with their types.

    A key of ``algo`` goes to the loss, to the optimisation step or to the loop, one of ``perception`` to the transform
    or to the environment: whichever takes it.
    """
    extra = {name: dict(hints) for name, hints in LOOP.items()}
    env, perception = parts.get("env"), parts.get("perception")
    if "algo" in parts:
        extra["algo"].update(_without(TO_STEPPER, arguments(find_class(STEPPER, object))))
    if is_part(env):
        taken = _arguments(env, "env", packages)
        extra["perception"] = _without(CONTEXT["env"], taken)
        own = _arguments(perception, "perception", packages) if is_part(perception) else {}
        for name in (set(perception or ()) & set(env or ()) & set(taken)) - set(own):  # one value would not be used
            raise UavrlError(f"perception.{name} and env.{name} are the same value: leave one of the two out.")
    return extra


def _without(names: Iterable[str], hints: Mapping[str, Any]) -> dict[str, Any]:
    return {name: hint for name, hint in hints.items() if name not in names}


def _arguments(part: Any, key: str, packages: tuple[str, ...]) -> Mapping[str, Any]:
    target = part[TARGET]
    return {} if target is None else arguments(find_class(str(target), object, packages, f"{key}.{TARGET}"))


def _validated(part: Any, key: str, packages: tuple[str, ...], extra: Mapping[str, Any]) -> Part:
    require(is_part(part), key, f"a part with a {TARGET}", part)
    values = {str(name): value for name, value in part.items() if name != TARGET}
    hints = _arguments(part, key, packages)
    if part[TARGET] is None:
        require_known(values, extra, key)
        return Part({TARGET: None, **values})
    refuse_context(key, [name for name in values if name in hints], context_of(key))
    require_known(values, {**extra, **hints}, key)
    inner = {name: value for name, value in values.items() if is_part(value)}
    others = {name: value for name, value in values.items() if name not in inner}
    found = validated(others, {**extra, **hints}, key)
    for name, value in inner.items():
        kind, place = _settings_of(hints.get(name)), f"{key}.{name}"
        if kind is None:
            found[name] = _validated(value, place, packages, {})
        else:
            found[name] = _validated_settings(value, kind, place, packages)
    return Part({TARGET: part[TARGET], **{name: found[name] for name in values}})


def _settings_of(hint: Any) -> type | None:
    """The base of the settings class that a type is, or that it may be; None for any other."""
    kind = next((each for each in (hint, *get_args(hint)) if is_dataclass(each) and isinstance(each, type)), None)
    return None if kind is None else [each for each in kind.__mro__ if is_dataclass(each)][-1]


def _validated_settings(part: Mapping[str, Any], kind: type, key: str, packages: tuple[str, ...]) -> Any:
    """The settings that a part names by their class, which derives from ``kind``."""
    made: type = find_class(str(part[TARGET]), kind, packages, f"{key}.{TARGET}")
    values = {name: value for name, value in part.items() if name != TARGET}
    parent, _, name = key.rpartition(".")
    return validated({name: values}, {name: made}, parent)[name]
