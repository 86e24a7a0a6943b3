"""Every key of ``conf/`` as a row of a table: its default, what ``preset=dagger`` makes of it, what it means."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from uavrl.cli.help import choice_keys, keys
from uavrl.config import compose, conf_dir

# The sections of the page, and the groups in each; "" are the keys of no group.
SECTIONS = {
    "algo": ("algo", "recurrent"),
    "actor_terms": ("fork", "lifeguard", "actor_penalty", "smoothness"),
    "demonstrator": ("demonstrator", "cloning"),
    "replay": ("buffer", "backward_reward"),
    "reward": ("reward",),
    "perception": ("perception",),
    "env": ("env",),
    "training": ("trainer", "validation", "collector", "logger", ""),
}
HEAD = ("key", "default", "`preset=dagger`", "meaning")
LONGEST = 8  # numbers of a list that are shown
MISSING = "???"  # stands for a value that must be given
_ABSENT = object()


def tables() -> dict[str, str]:
    """The tables in Markdown, by the names under which the page asks for them."""
    usual, best, pretrain = compose(), compose("preset=dagger"), compose(name="pretrain")
    made = {
        f"keys_{name}": _table(HEAD, [row for group in groups for row in _rows(group, usual, best)])
        for name, groups in SECTIONS.items()
    }
    rows = [(key, default, meaning) for key, default, _, meaning in _rows("pretrain", pretrain, pretrain, "pretrain")]
    return made | {"keys_pretrain": _table((*HEAD[:2], HEAD[3]), rows)}


def _rows(group: str, usual: DictConfig, best: DictConfig, name: str = "config") -> Iterator[tuple[str, ...]]:
    choices = sorted(file.stem for file in (conf_dir() / group).glob("*.yaml")) if group else []
    files = [choice_keys(group, choice).values() for choice in choices] or [keys(conf_dir() / f"{name}.yaml")]
    meanings: dict[str, str] = {}
    for key in (key for file in files for key in file):
        meanings.setdefault(key.name, key.meaning)
    composed = {choice: compose(f"{group}={choice}", name=name) for choice in choices}
    for key, meaning in meanings.items():
        default = _value(usual, key)
        others: dict[str, list[str]] = {}
        for choice, config in composed.items():
            if (value := _value(config, key)) not in (_ABSENT, default):
                others.setdefault(value, []).append(f"`{group}={choice}`")
        if default is _ABSENT and not others:
            continue  # a mapping, whose keys have rows of their own
        cells = [] if default is _ABSENT else [f"`{default}`"]
        cells += [f"{', '.join(choices)}: `{value}`" for value, choices in others.items()]
        chosen = _value(best, key)
        changed = "" if chosen in (_ABSENT, default) else f"`{chosen}`"
        yield f"`{key}`", "; ".join(cells), changed, re.sub(r"([\\`*_\[\]<>|$])", r"\\\1", meaning)


def _value(config: DictConfig, key: str) -> Any:
    """A key's value as one would type it; ``_ABSENT`` where there is none, or keys below it."""
    above, _, last = key.rpartition(".")
    node = OmegaConf.select(config, above) if above else config
    if isinstance(node, DictConfig) and OmegaConf.is_missing(node, last):
        return MISSING
    if not isinstance(node, DictConfig) or last not in node:
        return _ABSENT
    raw = OmegaConf.to_container(node, resolve=False)[last]  # type: ignore[index, call-overload]
    value = raw if "${now:" in str(raw) else node[last]
    if isinstance(value, DictConfig):
        return raw if isinstance(raw, str) else _ABSENT  # a text names keys that have rows elsewhere
    return _typed(value)


def _typed(value: Any) -> str:
    if isinstance(value, ListConfig | list):
        shown = [_typed(each) for each in value]
        if len(shown) > LONGEST:
            shown = [*shown[:2], "…", shown[-1]]
        return f"[{','.join(shown)}]"
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ("---",) * len(head), *rows))
