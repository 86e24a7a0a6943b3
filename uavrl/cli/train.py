"""``uavrl-train``: trains one policy, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import json
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from uavrl.cli.errors import CTRL_C, configure_logging, one_sentence, was_interrupted
from uavrl.configs import conf_dir, register_schemas, to_dataclass

register_schemas()
_FAILED: list[str] = []


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
            _train(config)
    except SystemExit as end:
        if end.code == CTRL_C:
            raise
        _FAILED.append(str(config.run_dir))


def _train(config: DictConfig) -> None:
    to_dataclass(config)
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    from uavrl.training.run import create_run, resume_config, train

    hydra_config = HydraConfig.get()
    resume = config.resume is not None
    if resume:
        run_dir = Path(str(config.resume))
        changed = [o.split("=", 1)[0].lstrip("+~") for o in hydra_config.overrides.task]
        config = resume_config(run_dir, config, [key for key in changed if key != "resume"])
        print(f"Resuming {run_dir}")
    else:
        if hydra_config.mode == RunMode.MULTIRUN:
            OmegaConf.update(config, "run_dir", f"{config.run_dir}_{hydra_config.job.num}")
        run_dir = create_run(config)
        print(f"Run folder: {run_dir}")
    try:
        summary = train(config, run_dir, resume=resume)
    except BaseException as error:
        if was_interrupted(error) and any((run_dir / "checkpoints").glob("checkpoint*")):
            print(f"\nStopped. Go on with: uavrl-train resume={run_dir}")
        raise
    print(json.dumps({k: summary[k] for k in ("episodes", "steps", "rates")}))
    print(f"Evaluate with: uavrl-evaluate run={run_dir}")


def main() -> None:
    """Entry point: trains, and exits with 1 where a run of a sweep failed."""
    _main()
    if _FAILED:
        raise SystemExit(f"uavrl: {len(_FAILED)} runs of the sweep failed, see above.")


if __name__ == "__main__":
    main()
