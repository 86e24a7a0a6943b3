"""One training run, new or resumed, in its folder."""

import json
import logging
import random
import shutil
import signal
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.checkpoint import Checkpoint

from uavrl.collectors.stall_notice import StallNotice
from uavrl.config import learner_name, validate
from uavrl.config.settings import TrainConfig
from uavrl.errors import FlyingEnded, Stopped, UavrlError, was_interrupted
from uavrl.runs.checkpoint import checkpoint_to_resume, how_to_go_on, restore
from uavrl.runs.config import MACHINE_KEYS, fingerprint, read_config
from uavrl.runs.directions import keep_directions, with_name_alone
from uavrl.runs.interrupts import Stop, stoppable
from uavrl.runs.lock import run_lock
from uavrl.runs.names import ARTIFACT, BEGUN, CHECKPOINTS, CONFIG, EPISODES, SUMMARY, TRAINING
from uavrl.runs.provenance import processor, versions
from uavrl.runs.shared_memory import hint_of_shared_memory, shared_memory_explained
from uavrl.runs.taken import has_no_checkpoint, refuse_a_run
from uavrl.runs.trust import check_links
from uavrl.training.build import build_trainer, prepare_valleys, with_stride
from uavrl.training.compiled import chosen_execution
from uavrl.training.loggers import close, truncate_logs
from uavrl.training.matmul import chosen_matmul, denormals_flushed, matmul_backend, matmul_here
from uavrl.training.progress import Progress, warn_of_late_learning, warn_of_nothing_learned
from uavrl.training.trainer import EpisodeTrainer
from uavrl_onboard.files import replacing
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)


def create_run(config: DictConfig) -> Path:
    """Makes the run folder with its resolved configuration."""
    run_dir = Path(str(config.run_dir))
    check_links(run_dir, TRAINING)
    refuse_a_run(run_dir, config.packages)
    # recorded: both bear on the last digits
    config.trainer.execution = chosen_execution(config.trainer.execution)
    config.trainer.matmul = chosen_matmul(config.trainer.matmul, config.trainer.threads)
    try:
        (run_dir / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
        with run_lock(run_dir):
            refuse_a_run(run_dir, config.packages)
            reset_unstarted_run(run_dir)
            (run_dir / BEGUN).touch()
            keep_directions(config, run_dir)
            _write(config, run_dir)
    except OSError as error:
        raise UavrlError(
            f"The run folder {run_dir} cannot be written ({error.strerror}): choose another with run_dir=FOLDER."
        ) from error
    return run_dir


def _write(config: DictConfig, run_dir: Path) -> None:
    with replacing(run_dir / CONFIG) as partial_config:
        partial_config.write_text(OmegaConf.to_yaml(with_name_alone(config), resolve=True), encoding="utf-8")


def train(
    config: DictConfig, run_dir: Path, *, resume: bool = False, begun: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Trains until there are enough episodes or steps, or the policy is good enough; ``create_run`` made ``run_dir``.

    ``begun`` is called once all is built: what can be refused was not.
    """
    if resume:
        check_links(run_dir, TRAINING)
    backend, threads = config.trainer.matmul, config.trainer.threads
    with (
        run_lock(run_dir),
        denormals_flushed(),
        matmul_backend(backend, threads),
        shared_memory_explained(),
        stoppable() as stop,
    ):
        try:
            return _train(config, run_dir, stop, begun, resume=resume)
        except BaseException as error:
            if stop.signal is None and not was_interrupted(error):
                if isinstance(error, FlyingEnded):
                    go_on = how_to_go_on(run_dir, config.packages) + hint_of_shared_memory()
                    raise FlyingEnded(error.reason, go_on) from error
                raise
            raise Stopped(how_to_go_on(run_dir, config.packages), stop.signal or signal.SIGINT) from None


def _train(config: DictConfig, run_dir: Path, stop: Stop, begun: Callable[[], None], *, resume: bool) -> dict[str, Any]:
    settings = validate(config)
    torch.set_num_threads(settings.trainer.threads)
    seed_everything(settings.seed)
    if resume and has_no_checkpoint(run_dir):
        log.info("%s was stopped before its first episode: it starts from the beginning.", run_dir)
        _clear(run_dir)
        _write(config, run_dir)
        resume = False
    checkpoint = checkpoint_to_resume(run_dir, config) if resume else None
    _drop_unfinished_checkpoints(run_dir)
    try:
        warn_of_late_learning(settings)
        with_stride(settings)  # refuses a stride before valleys are built
        prepare_valleys(settings)
        with StallNotice("The world and the networks are still being built: large ones take minutes."):
            trainer = build_trainer(settings, config, run_dir)
    except Exception:
        if not resume:
            reset_unstarted_run(run_dir)
        raise
    trainer.stop = stop
    try:
        begun()
        if checkpoint is not None:
            _restore_run(trainer, checkpoint, config, run_dir)
        else:
            trainer.save()
        trainer.progress = Progress(
            settings.trainer.episodes,
            settings.trainer.window,
            enabled=settings.trainer.progress,
            done=trainer.episode_log.count,
            steps=trainer.collected_frames,
            last_step=settings.trainer.steps,
            learning_starts=settings.algo.learning_starts,
            demonstrated=settings.demonstrated,
            max_steps=settings.env.get("max_steps", 0),
            until_success=settings.trainer.until_success,
        )
        if trainer.validation is not None and trainer.validation.found:
            trainer.progress.validated = str(trainer.validation.found[-1])
        if trainer.finished:
            more = "trainer.episodes, trainer.steps or trainer.until_success must ask for more"
            log.info("%s has ended: %s.", run_dir, more)
        else:
            trainer.train()
        return _summarize(trainer, settings, run_dir)
    finally:
        stop.shutting_down()
        trainer.progress.close()
        if trainer.validation is not None:
            trainer.validation.close()
        trainer.collector.shutdown()
        close(trainer.log.logger)


def reset_unstarted_run(run_dir: Path) -> None:
    """Makes a folder whose run never reached its first checkpoint free for another try; others stay as they are."""
    if not (run_dir / BEGUN).exists():
        return
    _clear(run_dir)
    for name in (CONFIG, BEGUN):
        (run_dir / name).unlink(missing_ok=True)


def _clear(run_dir: Path) -> None:
    """Removes what a run made before its first checkpoint, but for its configuration."""
    (run_dir / EPISODES).unlink(missing_ok=True)
    shutil.rmtree(run_dir / ARTIFACT, ignore_errors=True)
    _drop_unfinished_checkpoints(run_dir)


def _drop_unfinished_checkpoints(run_dir: Path) -> None:
    """Removes what a process left that was killed while it saved."""
    for leftover in (run_dir / CHECKPOINTS).glob(".checkpoint*"):
        shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()


def seed_everything(seed: int) -> None:
    """Seeds the process-wide generators: weights, exploration, sampling and target noise draw from them."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  (TorchRL's prioritised sampler draws from it)
    torch.manual_seed(seed)


def _restore_run(trainer: EpisodeTrainer, checkpoint: Path, config: DictConfig, run_dir: Path) -> None:
    """Makes trainer and run folder what they were after the barrier of a checkpoint."""
    _restore(trainer, checkpoint)
    trainer.seconds_before = Checkpoint.manifest(checkpoint)["metadata"]["seconds"]
    truncate_logs(trainer.log.logger, run_dir, trainer.collected_frames)
    done = f"{pluralize(trainer.episode_log.count, 'episode')}, {pluralize(trainer.collected_frames, 'step')}"
    log.info("Resumed %s after %s.", run_dir, done)
    trainer.barrier()
    _write(config, run_dir)


def _restore(trainer: EpisodeTrainer, path: Path) -> None:
    checkpoint = trainer.checkpoint
    if checkpoint.components.keys() - Checkpoint.manifest(path)["components"].keys():
        raise UavrlError(
            f"{path} was written by another version of uavrl, whose runs this version cannot resume: evaluate its "
            f"policy, or train again."
        )
    restore(checkpoint, path, [name for name in checkpoint.components if name != "episode_log"])
    restore(checkpoint, path, ["episode_log"])  # last, because it cuts a file back


def _summarize(trainer: EpisodeTrainer, settings: TrainConfig, run_dir: Path) -> dict[str, Any]:
    summary: dict[str, Any] = {
        **{name: settings.choices.get(name, "") for name in ("algo", "env", "reward")},
        "learner": learner_name(settings.choices),
        "seed": settings.seed,
        "episodes": trainer.episode_log.count,
        "steps": trainer.collected_frames,
        "steps_flown": trainer.steps_flown,
        "updates": trainer.updates,
        "minutes": trainer.seconds / 60,
        "window": settings.trainer.window,
        "rates": trainer.episode_log.rates(),
        "mean_return": trainer.episode_log.mean_return(),
        "validations": [] if trainer.validation is None else [asdict(each) for each in trainer.validation.found],
        "reached_success": trainer.reached,
        "versions": versions(),
        "processor": processor(),
    }
    warn_of_nothing_learned(settings, summary["steps"], summary["updates"])
    with replacing(run_dir / SUMMARY) as partial:
        partial.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


def resume_config(run_dir: Path, overrides: DictConfig, changed: list[str]) -> DictConfig:
    """The configuration of a run to go on with."""
    config = read_config(run_dir)
    before, machine = fingerprint(config), _of_the_machine(config)
    config.packages = overrides.packages  # whom the one trusts who runs this, whatever the file says
    address = config.collector.get("address")
    if address is not None and "collector.address" not in changed:  # what a Ray cluster sends is unpickled
        raise UavrlError(
            f"{run_dir} was trained on the Ray cluster {address}, and a run's folder may not choose whom this machine "
            f"trusts: add collector=ray collector.address={address}, or collector.address=null for this machine only."
        )
    chosen = OmegaConf.select(overrides, "choices") or {}
    for key in changed:
        if key == "run_dir":  # it keeps the name that it was given, by which loggers know it
            continue
        if key in chosen and config.choices.get(key) == chosen[key]:  # the same part, which is the run's own
            continue
        OmegaConf.update(config, key, OmegaConf.select(overrides, key), merge=False)
    if fingerprint(config) != before:
        raise UavrlError(
            f"resume={run_dir} continues with the run's own configuration, but {', '.join(changed)} would change it: "
            f"leave that out, or start a new run."
        )
    found_here = chosen_matmul if "trainer.matmul" in changed else matmul_here
    config.trainer.matmul = found_here(config.trainer.matmul, config.trainer.threads)
    config.trainer.execution = chosen_execution(config.trainer.execution)
    now = _of_the_machine(config)
    if others := [f"{key}={now[key]} (before: {machine.get(key)})" for key in now if now[key] != machine.get(key)]:
        log.info("%s continues with %s: from here on the last digits may differ.", run_dir, ", ".join(others))
    return config


def _of_the_machine(config: DictConfig) -> dict[str, Any]:
    found = {key: OmegaConf.select(config, key) for key in MACHINE_KEYS}
    return {key: value for key, value in found.items() if value is not None}
