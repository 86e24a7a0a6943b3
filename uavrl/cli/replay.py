"""``uavrl-replay``: flies a few tasks without noise and shows them in a page, and in a film."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from uavrl.cli.command import command, given_overrides
from uavrl.cli.policies import (
    baseline,
    checkpoint_path,
    load_policy,
    name_of_output,
    policy_folder,
    told_apart,
    with_overrides,
    writable,
)
from uavrl.configs import checked, to_dataclass
from uavrl.configs.replay import ReplayConfig
from uavrl.errors import UavrlError

if TYPE_CHECKING:
    from uavrl.training.flight import Replay

VIDEO_SUFFIXES = (".mp4", ".mkv", ".webm", ".avi", ".mov")


@command("replay")
def main(config: DictConfig) -> None:
    """Makes one page."""
    _replay(config, given_overrides())


def _replay(config: DictConfig, overrides: list[str]) -> None:
    settings = checked(config, ReplayConfig)
    if sum(source is not None for source in (settings.run, settings.policy, settings.flight)) != 1:
        raise UavrlError("Give one of run=RUN_FOLDER, policy=NAME and flight=FILE.npz, and no two of them.")
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    from uavrl.reporting.flight_page import needs_plotly, write_page
    from uavrl.reporting.flight_video import needs_imageio, write_video
    from uavrl.training.arithmetic import multiplied_by
    from uavrl.training.flight import load_replay, save_replay
    from uavrl.training.whereabouts import whereabouts_lines

    needs_plotly()
    if settings.video:
        needs_imageio()
    # All that can be wrong with the input is found before a folder is made or anything is flown.
    loaded = load_replay(Path(settings.flight)) if settings.flight else _prepared(settings, config, overrides)
    outputs = _outputs(settings, overrides)
    with multiplied_by(settings.products, settings.threads):
        shown = loaded() if callable(loaded) else loaded
    for flight in shown.flights:
        summary = flight.summary
        print(
            f"task {summary.task}: {summary.outcome.replace('_', ' ')} after {summary.steps} steps, path efficiency "
            f"{summary.path_efficiency:.2f}, minimum clearance {summary.clearance:.2f} m"
        )
        print("\n".join(f"  {line}" for line in whereabouts_lines(flight.whereabouts)))
    write_page(shown, outputs["output"])
    if settings.data:
        save_replay(shown, outputs["data"])
    if settings.video:
        write_video(shown.flights[0], shown.scenery(shown.flights[0]), outputs["video"], progress=settings.progress)
    for path in outputs.values():
        print(f"Written to {path}")


def _outputs(settings: ReplayConfig, overrides: list[str]) -> dict[str, Path]:
    """Where page, data and film go, found writable before anything is flown."""
    plain = ("run", "flight", "output", "video", "data", "points", "device", "threads", "products", "progress")
    folder = Path(settings.run or (Path(settings.flight).parent if settings.flight else "."))
    paths = {
        "output": Path(settings.output or folder / (name_of_output("replay", told_apart(overrides, plain)) + ".html"))
    }
    if settings.video and Path(settings.video).suffix.lower() not in VIDEO_SUFFIXES:
        raise UavrlError(f"video must end in {', '.join(VIDEO_SUFFIXES)}, got {settings.video}.")
    paths |= {key: Path(path) for key in ("data", "video") if (path := getattr(settings, key))}
    return {key: writable(path, key) for key, path in paths.items()}


def _prepared(settings: ReplayConfig, config: DictConfig, overrides: list[str]) -> Callable[[], Replay]:
    """Loads what flies; the call that it returns flies it."""
    import torch

    from uavrl.training.exported import is_exported
    from uavrl.training.factory import make_device
    from uavrl.training.replay import load_risk, record_flights

    torch.set_num_threads(settings.threads)
    device = make_device(settings.device)
    env, perception, reward, risk = settings.env, settings.perception, settings.reward, None
    source: dict[str, Any]
    choices, packages = settings.choices, settings.packages
    folder = policy_folder(settings.run, settings.policy)
    if folder is not None:
        run_config, policy, source = load_policy(folder, settings.checkpoint, device, packages)
        changed = to_dataclass(with_overrides(run_config, config, overrides))
        env, perception, reward, choices = changed.env, changed.perception, changed.reward, changed.choices
        if "world" not in env:
            raise UavrlError(
                f"uavrl-replay shows flights in the valley, and {folder} is a run of {choices.get('env')}: see how it "
                f"does with uavrl-evaluate run={folder}."
            )
        if settings.checkpoint is not None or not is_exported(folder):  # LifeGuard is not exported
            risk = load_risk(changed, checkpoint_path(folder, settings.checkpoint), device)
        source["run"] = folder.resolve().name
    else:
        policy, source = baseline(str(settings.policy), env.world.flight_level), {"policy": settings.policy}
    if settings.valleys is not None:
        env.world.seeds = list(settings.valleys)
    return partial(
        record_flights,
        env,
        perception,
        policy,
        settings.task_numbers,
        seed=settings.seed,
        source={**source, "env": choices.get("env", ""), "seed": settings.seed},
        reward=reward,
        packages=packages,
        risk=risk,
        max_points=settings.points,
        progress=settings.progress,
    )


if __name__ == "__main__":
    main()
