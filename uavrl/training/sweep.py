"""The combinations of a sweep: each has a folder of its own, and is found there when the sweep is started again."""

import copy
import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uavrl.errors import UavrlError
from uavrl.runs.config import FREE_KEYS, MACHINE_KEYS, fingerprint, read_config
from uavrl.runs.directions import KEY, by_content
from uavrl.runs.episodes import read_episodes
from uavrl.runs.names import ANY_CHECKPOINT, CONFIG, EPISODES, LONGEST_NAME, SUMMARY
from uavrl.training.run import reset_unstarted_run
from uavrl_onboard.pluralize import pluralize

_RUN_NAME = "${uavrl_run_name:}"
# What that name says: the parts themselves, and our presets of them, no two of which are alike in all of these.
_NAMED = (
    *("env", "algo", "fork", "lifeguard", "actor_penalty", "smoothness", "cloning", "backward_reward", "reward"),
    *("learner", "reward_preset"),
)
_SHOWN = 3  # differences that a sentence names


def run_folder(config: DictConfig, differences: Mapping[str, str]) -> Path:
    """Adds what distinguishes this combination to ``config.run_dir``, and returns it.

    All machines that share a sweep find its runs so, and one that is started again for longer runs goes on. What
    ``run_dir`` follows by itself, such as ``${seed}``, is not said again; the seed is always said.

    Args:
        config: of the run, with ``run_dir`` as it was written.
        differences: the values of the keys that the sweep varies.
    """
    written = str(OmegaConf.to_container(config)["run_dir"])  # type: ignore[call-overload,index]
    said = {key for key in differences if f"${{{key}}}" in written} | (set(_NAMED) if _RUN_NAME in written else set())
    told = {key: value for key, value in differences.items() if key != "seed" and key not in said and not _is_free(key)}
    if "${seed}" not in written:  # also of one seed: more may follow
        told["seed"] = str(config.seed)
    name = combination_name(told)
    if len(name) > LONGEST_NAME:
        name = f"{name[:LONGEST_NAME]}_{fingerprint(config)[:6]}"
    folder = str(Path(config.run_dir).expanduser())
    between = "/" if str(config.run_dir).endswith("/") else "_"
    run_dir = Path(f"{folder}{between}{name}" if name else folder)
    OmegaConf.update(config, "run_dir", str(run_dir))
    return run_dir


def combination_name(differences: Mapping[str, str]) -> str:
    """The values that a combination has, as part of a folder's name.

    Examples:
        >>> combination_name({"algo.gamma": "0.98", "seed": "1"})
        'gamma=0.98_seed=1'
        >>> combination_name({"algo.lr": "3e-4", "lifeguard.lr": "[1,2]"})
        'algo.lr=3e-4_lifeguard.lr=1-2'
    """
    ends = Counter(key.rpartition(".")[2] for key in differences)
    parts = []
    for key, value in differences.items():
        end = key.rpartition(".")[2]
        parts.append(f"{end if ends[end] == 1 else key}={value.strip('[]{} ')}")
    return "_".join(re.sub(r"[^\w.=-]+", "-", part) for part in parts)


def _is_free(key: str) -> bool:
    return any(key == free or key.startswith(f"{free}.") for free in (*FREE_KEYS, *MACHINE_KEYS))


def require_same_run(run_dir: Path, config: DictConfig) -> None:
    """Refuses a folder with a run of other settings, which another sweep has given the same name."""
    if not (run_dir / CONFIG).is_file():
        return
    theirs = read_config(run_dir)
    if fingerprint(theirs) == fingerprint(config):
        return
    ours = copy.deepcopy(config)
    for each in (theirs, ours):
        by_content(each)
    pairs = [(key, OmegaConf.select(theirs, key), value) for key, value in _values(ours).items()]
    rays = f"{KEY} names a file with other rays"
    other = [
        rays if key == KEY and old is not None else f"{key} is {old}, not {new}"
        for key, old, new in pairs
        if old != new and not _is_free(key)
    ][:_SHOWN]
    raise UavrlError(
        f"{run_dir} contains a run with other settings ({'; '.join(other) or 'it has further keys'}): choose another "
        f"run_dir, or remove that folder."
    )


def _values(config: DictConfig) -> dict[str, Any]:
    """The values of a resolved configuration by their dotted names; lists as they are."""

    def below(node: Any, name: str) -> dict[str, Any]:
        if not isinstance(node, DictConfig) or not node:
            return {name: node}
        return {key: value for each, inner in node.items() for key, value in below(inner, f"{name}.{each!s}").items()}

    return {key.removeprefix("."): value for key, value in below(config, "").items()}


def is_finished(run_dir: Path, episodes: int, steps: int | None = None) -> bool:
    """Whether a run has made its episodes, or its steps."""
    return _flown(run_dir, "episodes") >= episodes or (steps is not None and _flown(run_dir, "steps") >= steps)


def is_begun(run_dir: Path) -> bool:
    """Whether a run can be gone on with; a folder that never came to its first checkpoint is freed. Hold its lock."""
    if any(run_dir.glob(ANY_CHECKPOINT)):
        return True
    if (run_dir / EPISODES).exists() and (flown := len(read_episodes(run_dir / EPISODES))):
        raise UavrlError(
            f"{run_dir} contains {pluralize(flown, 'episode')} but no checkpoint to resume from: restore its "
            f"checkpoints, or move the folder away to train again."
        )
    reset_unstarted_run(run_dir)
    return False


def summary_lines(run_dirs: list[Path]) -> str:
    """What stands of a sweep, a line for each run."""
    lines = (f"\n  {run_dir}: {pluralize(_flown(run_dir, 'episodes'), 'episode')}" for run_dir in run_dirs)
    return f"The sweep's {pluralize(len(run_dirs), 'run')}:{''.join(lines)}"


def _flown(run_dir: Path, what: str) -> int:
    """A number of a summary; 0 where there is none, or a damaged one, which the end of the run writes anew."""
    try:
        return int(json.loads((run_dir / SUMMARY).read_text(encoding="utf-8"))[what])
    except (OSError, ValueError, KeyError, TypeError):
        return 0
