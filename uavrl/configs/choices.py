"""Which choices and keys there are on the command line, and which of them contradict each other."""

from collections.abc import Mapping
from typing import Any, cast

from omegaconf import OmegaConf

from uavrl.configs.registry import conf_dir
from uavrl.errors import UavrlError

ROWS = ("scheme", "learner")  # groups whose choices stand for choices of other groups


def known_keys(name: str) -> list[str]:
    """All keys and groups of ``conf/NAME.yaml`` with every choice of its groups, dotted."""
    folder = conf_dir()
    config = cast(dict[str, Any], OmegaConf.to_container(OmegaConf.load(folder / f"{name}.yaml")))
    keys = _dotted(config)
    groups = {str(group) for entry in config["defaults"] if isinstance(entry, dict) for group in entry}
    for path in folder.glob("*/*.yaml"):
        group = path.parent.name
        if group not in groups:
            continue
        below = OmegaConf.to_container(OmegaConf.load(path))
        below = (
            below.get(group, below) if isinstance(below, dict) else below
        )  # what is at home at the root names its group
        keys |= {group, *(f"{group}.{key}" for key in _dotted(below))}
    return sorted(keys)


def choices_with(key: str) -> list[str]:
    """The choices of a group whose yaml has a dotted key of it."""
    group, _, below = key.partition(".")
    folder = conf_dir() / group

    def has(stem: str) -> bool:
        content = cast(dict[str, Any], OmegaConf.to_container(OmegaConf.load(folder / f"{stem}.yaml")))
        bases = [base for base in content.get("defaults", []) if isinstance(base, str) and base != "_self_"]
        return below in _dotted(content) or any(map(has, bases))

    return sorted(path.stem for path in folder.glob("*.yaml") if has(path.stem))


def _dotted(node: object) -> set[str]:
    if not isinstance(node, dict):
        return set()
    keys = {str(key) for key in node if key not in ("defaults", "hydra", "_target_")}
    return keys | {f"{key}.{below}" for key in keys for below in _dotted(node[key])}


def check_choices(choices: Mapping[str, str | None]) -> None:
    """Refuses choices that a scheme or a learner contradicts."""
    for row in ROWS:
        path = conf_dir() / row / f"{choices.get(row)}.yaml"
        for entry in OmegaConf.load(path).defaults if path.is_file() else []:
            for override, chosen in entry.items() if not isinstance(entry, str) else []:
                group = str(override).removeprefix("override /")
                if choices.get(group) != chosen:
                    raise UavrlError(
                        f"{row}={choices[row]} stands for {group}={chosen}, and {group}={choices.get(group)} was "
                        f"chosen: leave one of the two out."
                    )
