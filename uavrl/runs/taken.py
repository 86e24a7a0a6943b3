"""Whether a folder is free for a new run; it is found out without PyTorch."""

from collections.abc import Iterable
from pathlib import Path

from uavrl.config.command_line import command_line, trusting
from uavrl.errors import FolderTaken
from uavrl.runs.episodes import read_episodes
from uavrl.runs.names import ANY_CHECKPOINT, ARTIFACT, BEGUN, CONFIG, EPISODES, SUMMARY


def has_no_checkpoint(run_dir: Path) -> bool:
    """Whether a run was stopped before its first checkpoint, which comes before its first episode: nothing is lost."""
    episodes = run_dir / EPISODES
    return (
        (run_dir / BEGUN).exists()
        and not (run_dir / SUMMARY).exists()
        and not any(run_dir.glob(ANY_CHECKPOINT))
        and not (episodes.exists() and read_episodes(episodes))
    )


def refuse_a_run(run_dir: Path, packages: Iterable[str]) -> None:
    """Refuse a folder that contains a run from which something would be lost."""
    if has_no_checkpoint(run_dir):
        return
    if any(run_dir.glob(ANY_CHECKPOINT)):
        go_on = command_line("uavrl-train", resume=run_dir, **trusting(packages))
        raise FolderTaken(
            f"The run folder {run_dir} already contains a run: resume it with {go_on}, or choose another run_dir."
        )
    if any((run_dir / name).exists() for name in (CONFIG, EPISODES, ARTIFACT)):
        raise FolderTaken(
            f"The run folder {run_dir} already contains a run without checkpoints: choose another run_dir."
        )
