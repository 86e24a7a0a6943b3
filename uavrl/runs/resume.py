"""From where a run goes on that was stopped, killed or damaged."""

import logging
from pathlib import Path

from omegaconf import DictConfig
from torchrl.checkpoint import Checkpoint

from uavrl.command_line import command_line
from uavrl.errors import UavrlError
from uavrl.runs.checkpoint import DamagedCheckpoint, all_checkpoints, check_checkpoint
from uavrl.runs.config import fingerprint, read_config
from uavrl.runs.episodes import read_episodes
from uavrl.runs.names import ANY_CHECKPOINT, BEGUN, EPISODES, SUMMARY

log = logging.getLogger(__name__)


def has_no_checkpoint(run_dir: Path) -> bool:
    """Whether a run was stopped before its first checkpoint, which comes before its first flight: nothing is lost."""
    episodes = run_dir / EPISODES
    return (
        (run_dir / BEGUN).exists()
        and not (run_dir / SUMMARY).exists()
        and not any(run_dir.glob(ANY_CHECKPOINT))
        and not (episodes.exists() and read_episodes(episodes))
    )


def checkpoint_to_resume(run_dir: Path, config: DictConfig) -> Path:
    """The newest checkpoint that is whole and knows no episode that ``episodes.csv`` has lost.

    Newer ones are renamed, so that nothing takes them for the run's, and what happened is logged.

    Args:
        run_dir: the run's folder.
        config: to go on with. What it may change of the recorded one does not bear on the checkpoints.
    """
    recorded = read_config(run_dir)
    if fingerprint(config) != fingerprint(recorded):
        raise UavrlError(
            f"{run_dir} was flown under another configuration than the one given: go on with its own, or start a new "
            f"run."
        )
    found = all_checkpoints(run_dir)
    flown = len(read_episodes(run_dir / EPISODES))
    passed_over: dict[Path, str] = {}
    for path in reversed(found):
        try:
            saved = check_checkpoint(path, recorded)["episodes"]
        except DamagedCheckpoint as error:
            passed_over[path] = str(error)
            continue
        if saved <= flown:
            _set_aside(passed_over, saved)
            return path
        passed_over[path] = (
            f"The checkpoint {path} follows episode {saved}, and {run_dir / EPISODES} has lost those after {flown}."
        )
    raise UavrlError(
        f"{passed_over[found[-1]]} No older checkpoint is left to go on from: bring the file back, or start a new run."
    )


def _set_aside(passed_over: dict[Path, str], saved: int) -> None:
    for path, reason in passed_over.items():
        aside = path.replace(path.with_name(f"unused-{path.name}"))
        log.warning(
            "%s The run goes back to the one before, after episode %d; this one is now %s.", reason, saved, aside
        )


def how_to_go_on(run_dir: Path) -> str:
    """The sentence that a stopped run ends with."""
    go_on = command_line("uavrl-train", resume=run_dir)
    if not any(run_dir.glob(ANY_CHECKPOINT)):
        return f"stopped before the first flight: start it again, or {go_on}."
    try:
        saved = Checkpoint.manifest(all_checkpoints(run_dir)[-1])["metadata"]["episodes"]
        flown = len(read_episodes(run_dir / EPISODES))
    except Exception:  # damaged meanwhile: whoever goes on is told what, and nothing may hide that the run was stopped
        return f"stopped: go on with {go_on}."
    if flown == saved:
        return f"stopped after episode {flown}, which is saved: go on with {go_on}."
    again = f"episode {flown}" if flown == saved + 1 else f"episodes {saved + 1} to {flown}"
    return f"stopped after episode {flown}: {go_on} goes on after {saved} and flies {again} again."
