"""``uavrl-train``: trains one policy, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import json
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from uavrl.cli.errors import configure_logging, one_sentence
from uavrl.configs import conf_dir, register_schemas

register_schemas()


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="config")
def main(config: DictConfig) -> None:
    """Trains one run."""
    configure_logging()
    with one_sentence():
        _train(config)


def _train(config: DictConfig) -> None:
    # Imported here: --help and a mistyped key answer without loading torch.
    from uavrl.configs import to_dataclass
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
        to_dataclass(config)
        run_dir = create_run(config)
        print(f"Run folder: {run_dir}")
    try:
        summary = train(config, run_dir, resume=resume)
    except KeyboardInterrupt:
        print(f"\nStopped. Go on with: uavrl-train resume={run_dir}")
        raise
    print(json.dumps({k: summary[k] for k in ("episodes", "steps", "rates")}))
    print(f"Evaluate with: uavrl-evaluate run={run_dir}")


if __name__ == "__main__":
    main()
