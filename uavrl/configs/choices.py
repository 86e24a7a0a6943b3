"""Which choices and keys there are on the command line, and which of them contradict each other."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.configs.registry import conf_dir
from uavrl.errors import UavrlError

ROWS = ("scheme", "learner")  # groups whose choices stand for choices of other groups


def known_keys(name: str, own: Sequence[Path] = ()) -> list[str]:
    """All keys and groups of ``conf/NAME.yaml`` with every choice of its groups, dotted.

    Args:
        name: of the yaml file.
        own: the user's folders of yaml files, beside ours.
    """
    config = _content(conf_dir() / f"{name}.yaml")
    keys = _dotted(config)
    groups = {str(group) for entry in config["defaults"] if isinstance(entry, dict) for group in entry}
    for path in _files("*", own):
        group = path.parent.name
        if group not in groups:
            continue
        content = _content(path)
        below = content.get(group, content)  # what is at home at the root names its group
        keys |= {group, *(f"{group}.{key}" for key in _dotted(below))}
    return sorted(keys)


def choices_with(key: str, own: Sequence[Path] = ()) -> list[str]:
    """The choices of a group whose yaml has a dotted key of it."""
    group, _, below = key.partition(".")
    files = {path.stem: path for path in _files(group, own)}

    def has(stem: str) -> bool:
        content = _content(files[stem]) if stem in files else {}
        bases = [base for base in content.get("defaults", []) if isinstance(base, str) and base != "_self_"]
        return below in _dotted(content) or any(map(has, bases))

    return sorted(filter(has, files))


def _files(group: str, own: Sequence[Path]) -> Iterator[Path]:
    for folder in (conf_dir(), *own):
        yield from folder.glob(f"{group}/*.yaml")


def _content(path: Path) -> dict[str, Any]:
    """What a yaml file holds; nothing where it cannot be read, as one of the user's that was not chosen may be."""
    try:
        content = OmegaConf.to_container(OmegaConf.load(path))
    except (OSError, ValueError, yaml.YAMLError, OmegaConfBaseException):
        return {}
    return cast(dict[str, Any], content) if isinstance(content, dict) else {}


def _dotted(node: object) -> set[str]:
    if not isinstance(node, dict):
        return set()
    keys = {str(key) for key in node if key not in ("defaults", "hydra", "_target_")}
    return keys | {f"{key}.{below}" for key in keys for below in _dotted(node[key])}


def check_choices(choices: Mapping[str, str | None], own: Sequence[Path] = ()) -> None:
    """Refuses choices that a scheme or a learner contradicts, one of the user's folders too."""
    for row in ROWS:
        paths = (folder / row / f"{choices.get(row)}.yaml" for folder in (conf_dir(), *own))
        path = next(filter(Path.is_file, paths), None)
        for entry in _content(path).get("defaults", []) if path else []:
            for override, chosen in entry.items() if not isinstance(entry, str) else []:
                group = str(override).removeprefix("override /")
                if choices.get(group) != chosen:
                    raise UavrlError(
                        f"{row}={choices[row]} stands for {group}={chosen}, and {group}={choices.get(group)} was "
                        f"chosen: leave one of the two out."
                    )
