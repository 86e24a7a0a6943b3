"""Which choices and keys there are on the command line, and which of them contradict each other."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from omegaconf import OmegaConf

from uavrl.configs.registry import conf_dir
from uavrl.errors import UavrlError

SCHEMA = "_schema"  # ends the names of the dataclasses that the yaml files rest on


def is_schema(choice: str) -> bool:
    """Whether a choice is a dataclass that a yaml file rests on, and not for users."""
    return choice.endswith(SCHEMA)


def did_you_mean(given: str, known: Iterable[str], before: str = "", otherwise: str = "") -> str:
    """A question about the nearest known name, or what is said where none is near.

    Examples:
        >>> did_you_mean("td4", ["td3", "sac"])
        'did you mean td3?'
    """
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=0.6)
    text = f"did you mean {near[0]}?" if near else otherwise
    return before + text if text else "."


def known_keys(name: str) -> list[str]:
    """All keys and groups of ``conf/NAME.yaml`` with every choice of its groups, dotted."""
    folder = conf_dir()
    config: Any = OmegaConf.to_container(OmegaConf.load(folder / f"{name}.yaml"))
    keys = _dotted(config)
    groups = {str(group) for entry in config["defaults"] if isinstance(entry, dict) for group in entry}
    for path in folder.glob("*/*.yaml"):
        group = path.parent.name
        if group == "enhancer" and "algo" in groups:
            group = "algo." + path.stem.split("_")[0]
        elif group not in groups:
            continue
        keys |= {group, *(f"{group}.{key}" for key in _dotted(OmegaConf.to_container(OmegaConf.load(path))))}
    return sorted(keys)


def _dotted(node: object) -> set[str]:
    if not isinstance(node, dict):
        return set()
    keys = {str(key) for key in node if key not in ("defaults", "hydra")}
    return keys | {f"{key}.{below}" for key in keys for below in _dotted(node[key])}


def check_choices(choices: Mapping[str, str | None]) -> None:
    """Refuses choices that are not for users, and those that a scheme contradicts.

    Args:
        choices: what every group's choice is, by the group.

    Raises:
        UavrlError: naming the two choices of which one must go.

    Examples:
        >>> check_choices({"scheme": "tr", "reward": "traditional", "backward_reward": "none"})
    """
    for group, choice in choices.items():
        if is_schema(str(choice)):
            raise UavrlError(
                f"{group}={choice} is not a choice of its own: give {group}={str(choice)[: -len(SCHEMA)]}."
            )
    if (scheme := choices.get("scheme")) is None:
        return
    for entry in OmegaConf.load(conf_dir() / "scheme" / f"{scheme}.yaml").defaults:
        for override, chosen in entry.items():
            group = str(override).removeprefix("override /")
            if choices.get(group) != chosen:
                raise UavrlError(
                    f"scheme={scheme} stands for {group}={chosen}, and {group}={choices.get(group)} was chosen: leave "
                    f"one of the two out."
                )
