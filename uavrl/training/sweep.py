"""The combinations of a sweep: each has a folder of its own, and is found there when the sweep is started again."""

import json
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from uavrl.errors import UavrlError
from uavrl.runs.config import fingerprint
from uavrl.runs.episodes import read_episodes
from uavrl.runs.names import ANY_CHECKPOINT, EPISODES, SUMMARY
from uavrl.training.run import reset_unstarted_run
from uavrl_onboard.pluralize import pluralize


def run_folder(config: DictConfig) -> Path:
    """Ends ``config.run_dir`` in the configuration's fingerprint, and returns it.

    All machines that share a sweep find its runs so, and one that is started again for longer runs goes on.
    """
    run_dir = Path(f"{Path(config.run_dir).expanduser()}_{fingerprint(config)[:6]}")
    OmegaConf.update(config, "run_dir", str(run_dir))
    return run_dir


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
