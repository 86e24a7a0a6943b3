"""``uavrl-replay``: rolls out a policy in a few tasks without noise and shows them in a page or a video."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli.command import command, given_overrides
from uavrl.config import validate
from uavrl.config.command_line import command_line
from uavrl.config.settings import FlyingConfig
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import output_name, result_overrides
from uavrl.evaluation.policies import policy_folder, require_named
from uavrl.evaluation.policy_setup import choose
from uavrl.evaluation.worlds import UNSEEN
from uavrl.runs.weights import POLICY
from uavrl_onboard.files import writable
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.ranges import Count, Folder
from uavrl_onboard.sentences import require

if TYPE_CHECKING:
    from uavrl.evaluation.recording import Recording


log = logging.getLogger(__name__)
MOST_FLIGHTS = 50  # in one page
LOG = ".mcap"  # the suffix of what uavrl-fly writes
VIDEOS = (".mp4", ".gif")


@dataclass
class ReplayConfig(FlyingConfig):
    """conf/replay.yaml: the episodes of one page, or of a video."""

    flight: Folder | None = None
    task: int | None = None
    tasks: tuple[int, ...] | None = None
    episodes: Count | None = None
    data: Folder | None = None
    video: Folder | None = None
    points: Count = 1500

    def __post_init__(self) -> None:
        """Checks what belongs together."""
        super().__post_init__()
        keys = ("task", "tasks", "episodes", "valleys", "checkpoint")
        given = [key for key in keys if getattr(self, key) not in (None, UNSEEN)]
        chosen = [key for key in given if key in keys[:3]]
        require(len(chosen) <= 1, "The choice of tasks", "one of task, tasks and episodes", " and ".join(chosen))
        own = "the only choice, since the file brings its flights"
        require(self.flight is None or not given, "flight", f"{own} (leave {', '.join(given)} out)", self.flight)
        require(self.task is None or self.task >= 0, "task", "a number from 0", self.task)
        listed = self.tasks
        distinct = listed is None or (len(listed) > 0 and min(listed) >= 0 and len(set(listed)) == len(listed))
        require(distinct, "tasks", "a list of different numbers from 0", listed)
        few = len(self.task_numbers) <= MOST_FLIGHTS
        require(few, "The number of flights", f"at most {MOST_FLIGHTS} in one page", len(self.task_numbers))
        known = self.video is None or Path(self.video).suffix in VIDEOS
        require(known, "video", f"a file that ends in {' or '.join(VIDEOS)}", self.video)
        if self.video is not None and len(self.task_numbers) > 1:
            raise UavrlError(
                f"A video shows one episode, and you asked for {len(self.task_numbers)}: choose one with task=NUMBER."
            )

    @property
    def task_numbers(self) -> tuple[int, ...]:
        """The tasks, in their order; task 0 if none is chosen."""
        if self.tasks is not None:
            return tuple(self.tasks)
        return tuple(range(self.episodes)) if self.episodes is not None else (self.task or 0,)

    @property
    def makes_page(self) -> bool:
        """Whether a page is written: always, unless a video is asked for and no page."""
        return self.video is None or self.output is not None


@command("replay")
def main(config: DictConfig) -> None:
    """Makes one page or video."""
    require_named(config)  # before all else: validating the environment loads torch
    with suppress(OmegaConfBaseException):  # a value that cannot be read is told by validate
        if config.progress is True and (shown := config.run or config.policy or config.flight):
            log.info("Loading %s ...", shown)
    settings, overrides = validate(config, ReplayConfig), given_overrides()
    if sum(source is not None for source in (settings.run, settings.policy, settings.flight)) != 1:
        raise UavrlError(
            "Give one of run=RUN_FOLDER, policy=NAME and flight=FILE.npz (or a log, FILE.mcap), and no two of them."
        )
    if settings.flight and Path(settings.flight).suffix == LOG:
        _show_log(settings, Path(settings.flight))
        return
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    from uavrl.evaluation.interventions import intervention_texts
    from uavrl.evaluation.position_stats import position_texts
    from uavrl.evaluation.recording import load_recording, save_recording
    from uavrl.evaluation.smoothness import smoothness_texts
    from uavrl.runs.episodes import SAID, aligned
    from uavrl.training.matmul import matmul_backend
    from uavrl.viewer.flight_page import write_page
    from uavrl.viewer.video import require_libraries, require_one_episode, write_video
    from uavrl_onboard.pages.assembly import needs_plotly

    if settings.video is not None:
        require_libraries(Path(settings.video))
    if settings.makes_page:
        needs_plotly()
    # All that can be wrong with the input is found before a folder is made or the first step.
    loaded = load_recording(Path(settings.flight)) if settings.flight else _prepared(settings, config, overrides)
    if settings.video is not None and not callable(loaded):
        require_one_episode(loaded)
    outputs = _outputs(settings, overrides)
    with matmul_backend(settings.matmul, settings.threads):
        shown = loaded() if callable(loaded) else loaded
    for flight in shown.flights:
        summary = flight.summary
        ended = f"{SAID[summary.outcome]} after {pluralize(summary.steps, 'step')}"
        efficiency = summary.path_efficiency
        lengths = "" if efficiency is None else f"path efficiency {efficiency:.2f}, "
        print(f"task {summary.task}: {ended}, {lengths}minimum clearance {summary.clearance:.2f} m")
        texts = position_texts(flight.position_stats)
        texts |= smoothness_texts(summary.action_change, summary.yaw_reversals)
        texts |= intervention_texts(summary.guard_share, summary.guard_change)
        print("\n".join(f"  {line}" for line in aligned(texts.items())))
    if "output" in outputs:
        write_page(shown, outputs["output"])
    if "data" in outputs:
        save_recording(shown, outputs["data"])
    if "video" in outputs:
        write_video(shown, outputs["video"], progress=settings.progress)
    for path in outputs.values():
        print(f"Written to {path}")


def _show_log(settings: ReplayConfig, log: Path) -> None:
    """Makes the page of a real flight."""
    from uavrl.viewer.flight_page import write_data
    from uavrl.viewer.logged_page import logged_page_data
    from uavrl_onboard.flight.logged_flight import LoggedFlight
    from uavrl_onboard.pages.assembly import needs_plotly

    require(settings.data is None, "data", "left out with a log, which holds the numbers itself", settings.data)
    require(
        settings.video is None, "video", "left out with a log, since a video shows a simulated valley", settings.video
    )
    needs_plotly()
    data = logged_page_data(LoggedFlight(log), settings.points)
    output = writable(Path(settings.output or log.with_suffix(".html")), "output=FILE")
    (flight,) = data["flights"]
    facts = ", ".join(f"{name} {value}" for name, value in flight["facts"].items())
    print("\n".join([f"{log}: {flight['outcome']}, {facts}", *(f"  {note}" for note in flight["notes"])]))
    write_data(data, output)
    print(f"Written to {output}")


def _outputs(settings: ReplayConfig, overrides: list[str]) -> dict[str, Path]:
    """Where page, data and video go, found writable before the first step."""
    plain = ("run", "flight", "output", "data", "video", "points", "device", "threads", "matmul", "progress")
    folder = Path(settings.run or (Path(settings.flight).parent if settings.flight else "."))
    name = output_name("replay", result_overrides(overrides, plain)) + ".html"
    paths = {"output": Path(settings.output or folder / name)} if settings.makes_page else {}
    given = {"data": settings.data, "video": settings.video}
    paths |= {key: Path(file) for key, file in given.items() if file is not None}
    return {key: writable(path, f"{key}=FILE") for key, path in paths.items()}


def _prepared(settings: ReplayConfig, config: DictConfig, overrides: list[str]) -> Callable[[], Recording]:
    """Loads policy and environment; the call that it returns records the episodes."""
    import torch

    from uavrl.evaluation.environment import make_device, make_env
    from uavrl.evaluation.record import record_flights
    from uavrl.runs.checkpoint import checkpoint_path
    from uavrl.training.build import load_risk

    torch.set_num_threads(settings.threads)
    device = make_device(settings.device)
    folder = policy_folder(settings.run, settings.policy)
    chosen, risk = choose(settings, config, overrides, folder, device), None
    if folder is not None and chosen.run is not None:
        if "world" not in chosen.env:
            instead = f"see how it does with {command_line('uavrl-evaluate', run=folder)}"
            other = f"{folder} is a run of {chosen.choices.get('env')}"
            raise UavrlError(f"uavrl-replay shows flights in the valley, and {other}: {instead}.")
        if settings.checkpoint is not None or not POLICY.is_in(folder):  # LifeGuard is not exported
            risk = load_risk(chosen.run, checkpoint_path(folder, settings.checkpoint), device)
        chosen.source["run"] = folder.resolve().name
    source = {**chosen.source, "env": chosen.choices.get("env", ""), "seed": settings.seed}

    def record() -> Recording:
        parts, tasks = (chosen.env, chosen.perception, chosen.reward), settings.task_numbers
        context: dict[str, Any] = {"packages": settings.packages, "seed": settings.seed, "num_uavs": 1}
        context["tasks"] = tasks  # valleys that none of them needs are not built
        context |= {**chosen.env_options, "keep_cloud": True}
        env = make_env(*parts, measure_clearance=True, **context)
        kept: dict[str, Any] = {"seed": settings.seed, "source": source, "risk": risk, "max_points": settings.points}
        try:
            return record_flights(env, chosen.policy, tasks, progress=settings.progress, **kept)
        finally:
            env.close()

    return record


if __name__ == "__main__":
    main()
