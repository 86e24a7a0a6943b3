"""Where the yaml files lie, and how they become checked dataclasses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, cast

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.configs.checks import require, require_one_of
from uavrl.configs.evaluate import EvaluateConfig
from uavrl.configs.limits import check_most
from uavrl.configs.pretrain import PRETRAIN_GROUPS, PretrainConfig
from uavrl.configs.replay import ReplayConfig
from uavrl.configs.train import CHOSEN_GROUPS, GROUPS, TrainConfig
from uavrl.configs.walker import BipedalConfig, NoPerceptionConfig, WalkerRewardConfig
from uavrl.errors import UavrlError

# What a run did whose configuration is older than the group.
ABSENT = {"backward_reward": "none"}


def conf_dir() -> Path:
    """The folder of yaml files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for candidate in (package / "conf", package.parent / "conf"):
        if (candidate / "config.yaml").is_file():
            return candidate
    raise UavrlError(f"Expected the yaml files in {package / 'conf'} and found none: install uavrl again.")


def register_schemas() -> None:
    """Puts every dataclass into Hydra's ConfigStore; yaml files name theirs as ``<group>/<name>_schema``."""
    OmegaConf.register_new_resolver("with_lifeguard", _with_lifeguard, replace=True)
    OmegaConf.register_new_resolver("with_traditional_reward", _with_traditional_reward, replace=True)
    OmegaConf.register_new_resolver("random_steps", _random_steps, replace=True)
    OmegaConf.register_new_resolver("on_walker", _on_walker, replace=True)
    OmegaConf.register_new_resolver("learner", lambda *, _root_: learner(_root_), replace=True)
    ConfigStore.__deepcopy__ = _shared  # type: ignore[attr-defined]
    ConfigStore.list = _listed  # type: ignore[assignment,method-assign]
    store = ConfigStore.instance()
    store.store(name="train_schema", node=TrainConfig)
    store.store(name="evaluate_schema", node=EvaluateConfig)
    store.store(name="pretrain_schema", node=PretrainConfig)
    store.store(name="replay_schema", node=ReplayConfig)
    for group, schemas in {**GROUPS, **PRETRAIN_GROUPS}.items():
        for name, schema in schemas.items():
            store.store(group=group, name=f"{name}_schema", node=schema)


def _shared(store: ConfigStore, _: dict[int, Any]) -> ConfigStore:
    """The store is its own copy: Hydra copies it whole for every group that ``--help`` lists, and never changes it."""
    return store


def _listed(store: ConfigStore, path: str, _list: Callable[..., list[str]] = ConfigStore.list) -> list[str]:
    """The store's choices for users: ``--help`` lists no dataclass that a yaml file rests on."""
    return [name for name in _list(store, path) if not name.endswith("_schema.yaml")]


def _with_lifeguard(value: float, without: float, *, _root_: DictConfig) -> float:
    """``${with_lifeguard:A,B}`` is A where the algorithm has a LifeGuard, else B."""
    return without if OmegaConf.select(_root_, "algo.lifeguard") is None else value


def _with_traditional_reward(value: float, otherwise: float, *, _root_: DictConfig) -> float:
    """``${with_traditional_reward:A,B}`` is A where the traditional reward pays, else B."""
    return value if OmegaConf.select(_root_, "reward.name") == "traditional" else otherwise


def expected_steps(episodes: int, max_steps: int) -> int:
    """About how many steps random flights make: they end after a sixth of the steps that they may take.

    Examples:
        >>> expected_steps(60, 300)
        3000
    """
    return episodes * max_steps // 6


def _random_steps(most: int, *, _root_: DictConfig) -> int:
    """``${random_steps:N}`` is N, or a tenth of the steps that can be expected where that is less."""
    episodes, max_steps = (OmegaConf.select(_root_, key) for key in ("trainer.episodes", "env.max_steps"))
    return min(most, max(0, expected_steps(episodes, max_steps) // 10))


def _on_walker(choice: str, otherwise: str, *, _root_: DictConfig) -> str:
    """``${on_walker:A,B}`` in a defaults list, where the root holds the groups' choices: A for the walker, else B."""
    return choice if GROUPS["env"].get(str(_root_.env)) is BipedalConfig else otherwise


def learner(config: DictConfig) -> str:
    """What learns in a run, as part of a name: ``td3``, ``td3_fork_lg_mlp``, ``ddpg_abr_plus``."""
    parts = [str(config.algo.name).split("_")[0]]
    if OmegaConf.select(config, "algo.fork") is not None:
        parts.append("fork")
    if OmegaConf.select(config, "algo.lifeguard") is not None:
        parts.append("lg" if config.algo.lifeguard.model == "linear" else f"lg_{config.algo.lifeguard.model}")
    backward = OmegaConf.select(config, "backward_reward.name", default="none")
    return "_".join(parts if backward == "none" else [*parts, str(backward)])


def to_dataclass(config: DictConfig) -> Any:
    """Resolves a configuration and turns it into its dataclass, checking every value.

    Args:
        config: composed by Hydra, or the ``config.yaml`` of a run, which gets the types of :class:`TrainConfig`.

    Raises:
        UavrlError: naming the key whose value is missing or out of range.
    """
    try:
        if OmegaConf.get_type(config) is dict:
            config = _with_types(config)
        _check_keys(config)
        if OmegaConf.get_type(config) is TrainConfig:
            _check_environment(config)
        for key, value in _leaves(OmegaConf.to_container(config, resolve=True)):
            require(not isinstance(value, float) or math.isfinite(value), key, "a finite number", value)
            check_most(key, value)
        return _to_object(config)
    except UavrlError:
        raise
    except (OmegaConfBaseException, ValueError, TypeError) as error:
        place = getattr(error, "full_key", None)
        where, reason = f" at {place}" if place else "", str(error).splitlines()[0]
        raise UavrlError(f"The configuration does not hold together{where}: {reason}") from error


def _to_object(config: DictConfig) -> Any:
    """Makes the dataclasses. Those of the library know nothing of the keys above theirs, which are told here."""
    try:
        return OmegaConf.to_object(config)
    except OmegaConfBaseException:
        raise
    except ValueError as error:
        place, names = _refusing(config)
        said = str(error)
        if place and not said.startswith(place):
            first = said.split(maxsplit=1)[0].partition(".")[0]
            raise UavrlError(f"{place}.{said}" if first in names else f"{place}: {said}") from error
        raise


def _refusing(config: DictConfig, place: str = "") -> tuple[str, list[str]]:
    """The innermost part whose dataclass refuses its values, and the names of these."""
    for name in map(str, config):
        if OmegaConf.is_missing(config, name) or not isinstance(part := config[name], DictConfig):
            continue
        try:
            OmegaConf.to_object(part)
        except ValueError:
            return _refusing(part, f"{place}.{name}".lstrip("."))
    return place, list(map(str, config))


def _check_keys(config: DictConfig, above: str = "") -> None:
    """Refuses groups without a choice, and keys that no dataclass knows: ``+key=value`` adds any."""
    known = {field.name for field in fields(cast(Any, OmegaConf.get_type(config)))}
    for name in map(str, config):
        key = f"{above}{name}"
        if name not in known:
            raise UavrlError(f"There is no key {key!r}: leave it out; --help lists all keys.")
        if OmegaConf.is_missing(config, name) or OmegaConf.is_interpolation(config, name):
            continue
        node = config[name]
        groups = GROUPS | PRETRAIN_GROUPS
        require(node is not None or key not in groups, key, f"one of {', '.join(groups.get(key, ()))}", None)
        if isinstance(node, DictConfig) and is_dataclass(OmegaConf.get_type(node)):
            _check_keys(node, f"{key}.")


def _check_environment(config: DictConfig) -> None:
    """The walker brings its observation and its reward; those of the valley mean nothing to it, and vice versa."""
    names = {group: config[group].name for group in ("env", "perception", "reward", "buffer", "backward_reward")}
    walker, env = GROUPS["env"].get(names["env"]) is BipedalConfig, f"with env={names['env']}"
    for group, own in (("perception", NoPerceptionConfig), ("reward", WalkerRewardConfig)):
        fitting = [name for name, schema in GROUPS[group].items() if (schema is own) == walker]
        require(names[group] in fitting, group, f"{' or '.join(fitting)} {env}", names[group])
    buffer, backward = names["buffer"], names["backward_reward"]
    require(walker or buffer != "failure_biased", "buffer", f"uniform or prioritized {env}", buffer)
    mirrors = not config.buffer.mirror or (not walker and config.perception.angles == "folded")
    require(mirrors, "buffer.mirror", "false, but in the valley with perception.angles=folded", True)
    require(not walker or backward == "none", "backward_reward", f"none {env}: it pays flights", backward)


def _with_types(config: DictConfig) -> DictConfig:
    """Merges a run's configuration, which yaml left without types, into the dataclasses that its names choose."""
    typed = OmegaConf.structured(TrainConfig)
    for group in CHOSEN_GROUPS:
        if group not in config and group in ABSENT:
            config = cast(DictConfig, OmegaConf.merge(config, {group: {"name": ABSENT[group]}}))
        name = str(OmegaConf.select(config, f"{group}.name"))
        require_one_of(name, f"{group}.name", list(GROUPS[group]))
        typed[group] = OmegaConf.structured(GROUPS[group][name])
    return cast(DictConfig, OmegaConf.merge(typed, config))


def _leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """All values below a plain container with their dotted keys; the items of a list share the list's key."""
    if isinstance(node, dict):
        for name, child in node.items():
            yield from _leaves(child, f"{key}.{name}" if key else str(name))
    elif isinstance(node, list):
        for child in node:
            yield from _leaves(child, key)
    else:
        yield key, node
