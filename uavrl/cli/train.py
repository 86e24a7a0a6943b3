"""``uavrl-train``: trains one policy, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import json
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from uavrl.cli.errors import configure_logging, one_sentence, sentence
from uavrl.configs import conf_dir, register_schemas, to_dataclass
from uavrl.errors import Stopped, UavrlError

register_schemas()


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="config")
def _main(config: DictConfig) -> None:
    """Trains one run; in a sweep a run that fails does not keep the others from flying."""
    configure_logging()
    if HydraConfig.get().mode != RunMode.MULTIRUN:
        with one_sentence():
            _train(config)
        return
    try:
        with one_sentence():
            _train_in_sweep(config)
    except SystemExit as end:
        if isinstance(end.__cause__, Stopped):
            raise
        # Hydra waits for the other runs, whatever launched them, and then ends with this sentence and exit code 1. It
        # holds the reason: what a cluster's job prints lies in a file of its own.
        failed = f"uavrl: the run {config.run_dir} of the sweep failed: {sentence(end.__cause__)}"
        raise CompactHydraException(failed) from None


def _train(config: DictConfig) -> None:
    to_dataclass(config)
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    from uavrl.training.run import create_run, resume_config

    if config.resume is None:
        _fly(config, create_run(config), resume=False)
        return
    run_dir = Path(str(config.resume))
    changed = [o.split("=", 1)[0].lstrip("+~") for o in HydraConfig.get().overrides.task]
    _fly(resume_config(run_dir, config, [key for key in changed if key != "resume"]), run_dir, resume=True)


def _train_in_sweep(config: DictConfig) -> None:
    """Trains a combination unless an earlier sweep has: then it goes on with it, or skips it where it is finished."""
    to_dataclass(config)
    if config.resume is not None:
        raise UavrlError(
            "resume=RUN_FOLDER goes on with one run: leave out -m and experiment. A sweep goes on when its own "
            "command is started again."
        )
    from uavrl.training.run import create_run
    from uavrl.training.sweep import take_place

    place = take_place(config)
    if place == "finished":
        print(f"Finished before: {config.run_dir}")
    elif place == "begun":
        _fly(config, Path(config.run_dir), resume=True)
    else:
        _fly(config, create_run(config), resume=False)


def _fly(config: DictConfig, run_dir: Path, *, resume: bool) -> None:
    from uavrl.training.run import train

    print(f"Resuming {run_dir}" if resume else f"Run folder: {run_dir}")
    summary = train(config, run_dir, resume=resume)
    print(json.dumps({k: summary[k] for k in ("episodes", "steps", "rates")}))
    print(f"Evaluate with: uavrl-evaluate run={run_dir}")


def main() -> None:
    """Entry point."""
    _main()


if __name__ == "__main__":
    main()
