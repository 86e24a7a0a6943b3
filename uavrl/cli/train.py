"""``uavrl-train``: trains one policy, or with ``-m`` one for each combination of values."""

import errno
import logging
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli import sweep_runs
from uavrl.cli.command import command
from uavrl.cli.logs import configure_logging
from uavrl.cli.memory import require_memory
from uavrl.config import TrainConfig, resolve, validate
from uavrl.config.command_line import command_line, trusting
from uavrl.config.validation import to_config
from uavrl.errors import FolderTaken, Stopped, UavrlError
from uavrl.runs.clock import start_clock
from uavrl.runs.config import require_typed_run
from uavrl.runs.episodes import RATES, success_text, wilson
from uavrl.runs.folders import made_folder
from uavrl.runs.names import ANY_CHECKPOINT, TRAINING
from uavrl.runs.taken import refuse_a_run
from uavrl.runs.trust import check_links
from uavrl_onboard.cli.process import one_sentence, sentence
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)
LOOK_AGAIN = 20.0  # s until a sweep looks again whether runs of other processes have ended


def main() -> None:
    """Trains one run, or a sweep: several processes may share one, and each stays until all of its runs have ended."""
    sweep_runs.forget()
    sweep_runs.note_swept(sys.argv[1:])
    _command()
    with one_sentence():
        sweep_runs.refuse_twice()
    if others := sweep_runs.runs(ended=False):
        configure_logging()  # again: Hydra has silenced it after the last run
        waiting = pluralize(len(others), "run")
        log.info("Waiting until other processes finish %s of the sweep.", waiting)
    while others := sweep_runs.runs(ended=False):
        with one_sentence():
            time.sleep(LOOK_AGAIN)
            from uavrl.runs.lock import is_locked

            all_held = all(map(is_locked, others))
        if not all_held:
            _command()
    if ended := sweep_runs.runs(ended=True):
        from uavrl.training.sweep import summary_lines

        with one_sentence():
            print(summary_lines(ended), flush=True)


@command("config")
def _command(config: DictConfig) -> sweep_runs.Outcome | None:
    """Trains one run; in a sweep a run that fails does not stop the others."""
    if HydraConfig.get().mode != RunMode.MULTIRUN:
        with one_sentence():
            _train(config)
        return None
    try:
        with one_sentence():
            return _train_in_sweep(config)
    except SystemExit as end:
        if isinstance(end.__cause__, Stopped):
            raise
        # Hydra waits for the other runs, whatever launched them, and then ends with this sentence and exit code 1. It
        # holds the reason: what a cluster's job prints lies in a file of its own.
        failed = f"The run {config.run_dir} of the sweep failed: {sentence(end.__cause__)}"
        raise CompactHydraException(failed) from None


def _train(config: DictConfig) -> None:
    require_typed_run(config, "resume")  # before all else: validating the environment loads torch
    _require_free(config)
    if OmegaConf.select(config, "trainer.progress") is True:
        log.info("Loading %s ...", OmegaConf.select(config, "resume") or "PyTorch")
    settings = validate(config)
    _check(settings)
    named_by_time = "${now:" in str(OmegaConf.to_container(config)["run_dir"])  # type: ignore[call-overload,index]
    config = to_config(settings)
    from uavrl.runs.lock import run_lock
    from uavrl.training.run import create_run, resume_config

    if config.resume is None:
        _check_machine(config)
        with made_folder(Path(config.run_dir), ANY_CHECKPOINT, another=named_by_time) as run_dir:
            config.run_dir = str(run_dir)
            with explain_full_disk(run_dir, config.packages), run_lock(run_dir):
                _fly(config, create_run(config), resume=False)
        return
    run_dir = Path(str(config.resume))
    changed = [o.split("=", 1)[0].lstrip("+~") for o in HydraConfig.get().overrides.task]
    config = resume_config(run_dir, config, [key for key in changed if key != "resume"])
    _check(validate(config))
    _check_machine(config)
    with explain_full_disk(run_dir, config.packages):
        _fly(config, run_dir, resume=True)


def _require_free(config: DictConfig) -> None:
    """Refuses a typed ``run_dir`` that contains a run, as ``create_run`` does, which comes after PyTorch."""
    typed = [each.partition("=")[0].lstrip("+") for each in HydraConfig.get().overrides.task]
    with suppress(OmegaConfBaseException, OSError):  # told by what needs them
        if config.resume is not None or "run_dir" not in typed or not isinstance(folder := config.run_dir, str):
            return
        if isinstance(config.packages, ListConfig) and folder.strip() and not folder.startswith("~"):
            check_links(Path(folder), TRAINING)
            refuse_a_run(Path(folder), map(str, config.packages))


@contextmanager
def explain_full_disk(run_dir: Path, packages: Iterable[str] = ()) -> Iterator[None]:
    """Says which file could not be written, and how to go on."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        begun = any(run_dir.glob(ANY_CHECKPOINT))
        go_on = command_line("uavrl-train", resume=run_dir, **trusting(packages))
        again = f"resume with {go_on}" if begun else "start it again"
        raise UavrlError(
            f"{error.filename or run_dir} cannot be written ({error.strerror}): make room on its disk, and {again}."
        ) from error


def _check(settings: TrainConfig) -> None:
    """Finds what can be wrong with the settings before a folder is made."""
    require_memory(settings)
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    from uavrl.training.loggers import require_login

    require_login(settings.logger, settings.packages)
    lidar = settings.perception.get("lidar")
    if lidar is not None and lidar.sensor != "vlp16":
        from uavrl.evaluation.field_of_view import check_field_of_view, warn_beyond_rows

        check_field_of_view(settings.perception, packages=settings.packages)
        warn_beyond_rows(settings.perception, settings.packages)


def _check_machine(config: DictConfig) -> None:
    """Finds what this machine has not, before a folder is made."""
    from uavrl.evaluation.environment import make_device
    from uavrl.training.matmul import chosen_matmul

    make_device(config.device)
    if "matmul" in config.trainer and config.trainer.matmul != "auto":
        chosen_matmul(config.trainer.matmul, config.trainer.threads)


def _train_in_sweep(config: DictConfig) -> sweep_runs.Outcome:
    """Trains a combination, goes on with it, or leaves it alone where it is finished or another process trains it."""
    start_clock()  # of this run
    _check(validate(config))
    if config.resume is not None:
        raise UavrlError(
            "resume= continues a single run: drop -m and experiment=. To resume a sweep, start its own command again."
        )
    from uavrl.runs.config import free_keys
    from uavrl.runs.lock import run_lock
    from uavrl.training.run import create_run, resume_config
    from uavrl.training.sweep import is_begun, is_finished, require_same_run, run_folder

    hydra = HydraConfig.get()
    run_dir = run_folder(config, sweep_runs.differences(hydra.overrides.task, hydra.sweeper.get("params") or {}))
    config = resolve(config)
    place = hydra.job.num
    if sweep_runs.has_another_place(run_dir, place):
        raise sweep_runs.same_run(run_dir)
    require_same_run(run_dir, config)
    if is_finished(run_dir, config.trainer.episodes, config.trainer.steps):
        if not sweep_runs.was_ended(run_dir):  # else it was told before this process waited for others
            print(f"Finished: {run_dir}")
        return sweep_runs.Outcome(run_dir, place, ended=True)
    try:
        _check_machine(config)
        with explain_full_disk(run_dir, config.packages), made_folder(run_dir, ANY_CHECKPOINT), run_lock(run_dir):
            if is_finished(run_dir, config.trainer.episodes, config.trainer.steps):  # meanwhile, by another process
                print(f"Finished: {run_dir}")
            elif is_begun(run_dir):
                _fly(resume_config(run_dir, config, free_keys(config)), run_dir, resume=True)
            else:
                _fly(config, create_run(config), resume=False)
    except FolderTaken as taken:
        log.info("%s", taken)
        return sweep_runs.Outcome(run_dir, place, ended=False)
    return sweep_runs.Outcome(run_dir, place, ended=True)


def _fly(config: DictConfig, run_dir: Path, *, resume: bool) -> None:
    from uavrl.training.run import train

    def tell() -> None:
        print(f"Resuming {run_dir}" if resume else f"Run folder: {run_dir}", flush=True)

    summary = train(config, run_dir, resume=resume, begun=tell)
    last = min(summary["episodes"], config.trainer.window)
    print(f"Trained for {pluralize(summary['episodes'], 'episode')}, {pluralize(summary['steps'], 'step')}.")
    if last:  # none where the run was shorter than its first episode
        solved = round(summary["rates"][RATES["success"]] * last)
        print(success_text(wilson(solved, last), last, "training episode"))
    trusted = trusting(config.packages)
    watch = f"; watch it: {command_line('uavrl-replay', run=run_dir, **trusted)}" if "world" in config.env else ""
    print(f"Evaluate it: {command_line('uavrl-evaluate', run=run_dir, **trusted)}{watch}")


if __name__ == "__main__":
    main()
