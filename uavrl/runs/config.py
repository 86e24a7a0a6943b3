"""The ``config.yaml`` of a run or a policy, which somebody else may have written, and its fingerprint."""

import hashlib
import io
import json
from contextlib import suppress
from pathlib import Path

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.errors import UavrlError
from uavrl.runs.directions import by_content, use_kept_directions
from uavrl.runs.names import CONFIG

# What may differ between a run and its continuation: none of it changes what is learned.
FREE_KEYS = (
    *("run_dir", "resume", "logger", "choices", "packages", "collector.address", "collector.workers"),
    *("trainer.episodes", "trainer.steps", "trainer.until_success", "trainer.progress", "trainer.keep_checkpoints"),
    "validation",
)
# What a run may change when it goes on, on another machine perhaps: it bears on the last digits alone.
MACHINE_KEYS = ("device", "trainer.execution", "trainer.threads", "trainer.matmul")
# What may differ between two seeds of one experiment.
HOW_IT_RUNS = (*FREE_KEYS, *MACHINE_KEYS, "trainer.window")
_MOST_BYTES = 1_000_000  # a configuration is of some 4,000


def fingerprint(config: DictConfig) -> str:
    """A hash of everything in a resolved configuration that changes what is learned."""
    plain = OmegaConf.create(OmegaConf.to_container(config, resolve=True))
    for key in (*FREE_KEYS, *MACHINE_KEYS):
        parent, _, leaf = key.rpartition(".")
        node = OmegaConf.select(plain, parent) if parent else plain
        if isinstance(node, DictConfig) and leaf in node:
            del node[leaf]
    assert isinstance(plain, DictConfig)
    by_content(plain)
    text = json.dumps(OmegaConf.to_container(plain), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def free_keys(config: DictConfig) -> list[str]:
    """What a sweep sets in a run that it goes on with: all that may change, but what the run has chosen by ``auto``."""
    found = {key: OmegaConf.select(config, key, default=key) for key in (*FREE_KEYS, *MACHINE_KEYS)}
    return [key for key, value in found.items() if value != key and not (key in MACHINE_KEYS[1:] and value == "auto")]


def read_config(run_dir: Path) -> DictConfig:
    """The resolved configuration of a run or a policy."""
    require_run(run_dir)
    path = run_dir / CONFIG
    try:
        config = load_config(path)
    except Exception as error:
        raise UavrlError(f"{path} is damaged: {' '.join(str(error).split())[:300]}.") from error
    if "algo" not in config:
        raise UavrlError(f"Expected the configuration of a run in {path}, but the file contains something else.")
    use_kept_directions(config, run_dir)
    return config


def require_folder(run_dir: Path) -> None:
    """Refuses what is no folder."""
    if not run_dir.is_dir():
        raise UavrlError(
            f"Expected a run folder at {run_dir} and found none: give the folder that uavrl-train printed."
        )


def require_run(run_dir: Path) -> None:
    """Refuses what is no folder of a run or a policy; loads no torch."""
    require_folder(run_dir)
    if not (run_dir / CONFIG).is_file():
        raise UavrlError(
            f"The folder {run_dir} contains no run, because {CONFIG} is missing: pass a folder that "
            f"uavrl-train printed."
        )


def require_typed_run(config: DictConfig, key: str = "run") -> None:
    """Requires the run that a command line names; ``~`` is expanded later, and validation reports what is no text."""
    with suppress(OmegaConfBaseException):
        if isinstance(folder := config[key], str) and folder.strip() and not folder.startswith("~"):
            require_run(Path(folder))


def load_config(path: Path) -> DictConfig:
    """Reads a configuration that a run has written: plain values.

    Others are refused: an interpolation could tell what the reader's environment holds (``${oc.env:TOKEN}``), and an
    alias of an alias of an alias can fill the memory.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"expected at most {_MOST_BYTES:,} bytes, found {path.stat().st_size:,}")
    text = path.read_text(encoding="utf-8")
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it holds an alias, which no run writes")
        if isinstance(event, yaml.ScalarEvent) and "${" in event.value:
            raise ValueError(f"it holds {event.value[:80]!r} to work out, and runs write plain values")
    loaded = OmegaConf.load(io.StringIO(text))
    if not isinstance(loaded, DictConfig):
        raise ValueError("it holds no configuration")
    return loaded
