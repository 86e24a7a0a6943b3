"""The ``config.yaml`` of a run or a policy, which somebody else may have written."""

from __future__ import annotations

import io
from pathlib import Path

import yaml
from omegaconf import DictConfig, OmegaConf

_MOST_BYTES = 1_000_000  # one is of some 4,000


def load_config(path: Path) -> DictConfig:
    """Reads a configuration that a run has written: plain values, with nothing left to work out.

    An interpolation could tell what the reader's environment holds (``${oc.env:TOKEN}``), and would stand in every
    result; an alias of an alias of an alias can fill the memory. Runs write neither.

    Raises:
        ValueError: naming what it holds that no run writes.
        yaml.YAMLError: when it is no yaml.
        OSError: when it cannot be read.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"expected at most {_MOST_BYTES:,} bytes, found {path.stat().st_size:,}")
    text = path.read_text()
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it holds an alias, which no run writes")
        if isinstance(event, yaml.ScalarEvent) and "${" in event.value:
            raise ValueError(f"it holds {event.value[:80]!r} to work out, and runs write plain values")
    loaded = OmegaConf.load(io.StringIO(text))
    if not isinstance(loaded, DictConfig):
        raise ValueError("it holds no configuration")
    return loaded
