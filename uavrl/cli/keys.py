"""Which choices and keys there are on the command line, and which of them contradict each other."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from uavrl.config.yaml_files import conf_dir
from uavrl.errors import UavrlError

ROWS = ("reward_preset", "learner")  # groups whose choices stand for choices of other groups


def known_keys(name: str, own: Sequence[Path] = ()) -> list[str]:
    """All keys and groups of ``conf/NAME.yaml`` with every choice of its groups, also in ``own`` folders, dotted."""
    config = _content(conf_dir() / f"{name}.yaml")
    groups = {str(group) for entry in config["defaults"] if isinstance(entry, dict) for group in entry}
    keys = _dotted(config)
    for folder in (conf_dir(), *own):
        for path in folder.glob("*/*.yaml"):
            if (group := path.parent.name) in groups:
                keys |= {group, *(f"{_place(path)}.{key}" for key in _dotted(_of_group(path)))}
        for path in folder.glob("*/*/*.yaml"):  # what several choices of a group share
            if (group := path.parent.parent.name) in groups:
                keys |= {f"{group}.{key}" for key in _dotted(_content(path))}
    return sorted(keys)


def choices_with(key: str, own: Sequence[Path] = ()) -> list[str]:
    """The choices of a group, as ``GROUP=NAME``, that hold a key; also those in ``own`` folders."""
    group, _, inside = key.partition(".")
    contents: dict[str, Any] = {}
    for folder in (conf_dir(), *own):
        contents |= {path.stem: _of_group(path) for path in sorted(folder.glob(f"{group}/*.yaml"))}

    def holds(name: str, asked: frozenset[str] = frozenset()) -> bool:
        content, asked = contents.get(name) or {}, asked | {name}  # files of the user's may name each other in a circle
        based_on = [each for each in content.get("defaults") or () if isinstance(each, str) and each not in asked]
        return inside in _dotted(content) or any(holds(each, asked) for each in based_on)

    return [f"{group}={name}" for name in contents if holds(name)]


def check_choices(choices: Mapping[str, str | None], own: Sequence[Path] = ()) -> None:
    """Refuses choices that a scheme or a learner contradicts, one of the user's folders too."""
    for row in ROWS:
        contents = (_content(folder / row / f"{choices.get(row)}.yaml") for folder in (conf_dir(), *own))
        for entry in next(filter(None, contents), {}).get("defaults", []):
            for override, chosen in entry.items() if isinstance(entry, dict) else []:
                group = str(override).removeprefix("override /")
                if choices.get(group) != chosen:
                    raise UavrlError(
                        f"{row}={choices[row]} selects {group}={chosen}, but the command line selects "
                        f"{group}={choices.get(group)}: leave one of the two out."
                    )


def _place(path: Path) -> str:
    """The key under which the keys of a file stand: its group, unless it says ``# @package KEY``."""
    with suppress(OSError, ValueError):
        if match := re.match(r"# @package (?!_global_)(\S+)", path.read_text(encoding="utf-8")):
            return match[1]
    return path.parent.name


def _of_group(path: Path) -> Any:
    """What a file holds of its group; one that is at home at the root names it."""
    content = _content(path)
    return content.get(path.parent.name, content)


def _content(path: Path) -> dict[str, Any]:
    """What a yaml file holds; nothing where it cannot be read, as one of the user's that was not chosen may be."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError):
        return {}
    return content if isinstance(content, dict) else {}


def _dotted(node: object, above: str = "") -> set[str]:
    keys = [key for key in node if key not in ("defaults", "hydra", "_target_")] if isinstance(node, dict) else []
    return {f"{above}{key}" for key in keys} | {each for key in keys for each in _dotted(node[key], f"{above}{key}.")}  # type: ignore[index]
