"""``uavrl-evaluate``: flies fixed tasks with the policy of a run, or with a policy that learns nothing."""

from __future__ import annotations

import errno
import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from uavrl.cli.errors import configure_logging, one_sentence
from uavrl.configs import conf_dir, register_schemas, to_dataclass
from uavrl.errors import UavrlError

if TYPE_CHECKING:
    from uavrl.configs import EvaluateConfig, TrainConfig

register_schemas()


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="evaluate")
def main(config: DictConfig) -> None:
    """Evaluates one policy."""
    configure_logging()
    with one_sentence():
        _evaluate(config, [override.lstrip("+") for override in HydraConfig.get().overrides.task])


def _evaluate(config: DictConfig, overrides: list[str]) -> None:
    import torch

    from uavrl.training.evaluation import fly, summarize_flights, table
    from uavrl.training.factory import make_device, make_env

    settings: EvaluateConfig = to_dataclass(config)
    torch.set_num_threads(settings.threads)
    device = make_device(settings.device)
    if (settings.run is None) == (settings.policy is None):
        raise UavrlError("Give either run=RUN_FOLDER or policy=straight, and not both.")
    env_config, perception = settings.env, settings.perception
    if settings.run is not None:
        run_config, policy, source = _load(Path(settings.run), settings.checkpoint, device)
        changed: TrainConfig = to_dataclass(_with_overrides(run_config, config, overrides))
        env_config, perception = changed.env, changed.perception
    else:
        policy, source = _baseline(str(settings.policy), env_config.world.flight_level), {"policy": settings.policy}
    output = _output(settings, overrides)
    if settings.valleys is not None:
        env_config = replace(env_config, world=replace(env_config.world, seeds=settings.valleys))
    env = make_env(
        env_config,
        perception,
        seed=settings.seed,
        num_uavs=min(settings.num_uavs, settings.episodes),
        measure_clearance=True,
    )
    try:
        flights = fly(env, policy, settings.episodes, progress=settings.progress)
    finally:
        env.close()
    result: dict[str, Any] = {
        **summarize_flights(flights),
        "seed": settings.seed,
        "env": env_config.name,
        "valleys": list(env_config.world.seeds),
        **source,
        "flights": [asdict(flight) for flight in flights],
    }
    partial = output.with_name(output.name + ".partial")
    partial.write_text(json.dumps(result, indent=1) + "\n")
    partial.replace(output)
    print(table(result))
    print(f"Written to {output}")


def _with_overrides(run_config: DictConfig, composed: DictConfig, overrides: list[str]) -> DictConfig:
    """The run's configuration with what the command line says about environment and sensor.

    ``env=NAME`` replaces the environment, ``env.key=value`` and ``perception.lidar.key=value`` change one value.
    """
    result = run_config.copy()
    keys = [override.split("=", 1)[0] for override in overrides]
    if "env" in keys:
        result.env = composed.env
    for key in keys:
        if key.startswith(("env.", "perception.lidar.")):
            OmegaConf.update(result, key, OmegaConf.select(composed, key), merge=False)
        elif key.split(".")[0] == "perception":
            raise UavrlError(
                f"{key} belongs to the policy of the run and cannot change in its evaluation: leave it out."
            )
    return result


def _output(settings: EvaluateConfig, overrides: list[str]) -> Path:
    """Where the result goes, found writable before anything is flown; what was changed stands in its name."""
    plain = ("run", "episodes", "output", "num_uavs", "device", "threads", "progress")
    told = [
        re.sub(r"[^\w.=-]+", "-", o).replace("=-", "=").strip("-") for o in overrides if o.split("=")[0] not in plain
    ]
    name = "_".join(["evaluation", *told]) + ".json"
    output = Path(settings.output or (Path(settings.run or ".") / name))
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        if output.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        partial = output.with_name(output.name + ".partial")
        partial.touch()
        partial.unlink()
    except OSError as error:
        raise UavrlError(f"{output} cannot be written ({error.strerror}): choose another with output=FILE.") from error
    return output


def _load(run_dir: Path, checkpoint: str | None, device: Any) -> tuple[DictConfig, Any, dict[str, Any]]:
    from torchrl.checkpoint import Checkpoint

    from uavrl.training.checkpoint import check_checkpoint, latest_checkpoint, read_config, restore
    from uavrl.training.learner import make_actor

    config = read_config(run_dir)
    path = Path(checkpoint) if checkpoint else latest_checkpoint(run_dir)
    if not path.is_file():
        raise UavrlError(f"Expected a checkpoint at {path} and found none: leave checkpoint out to take the newest.")
    train_config: TrainConfig = to_dataclass(config)
    metadata = check_checkpoint(path, config)
    actor = make_actor(train_config.algo, train_config.perception, device)
    restore(Checkpoint(policy=actor), path, ["policy"])
    source = {
        "run": str(run_dir),
        "checkpoint": path.name,
        "training_steps": metadata["collected_frames"],
        "training_episodes": metadata["episodes"],
    }

    def policy(tensordict: Any) -> Any:
        acted = actor(tensordict.select("observation").to(device))
        return tensordict.set("action", acted["action"].to(tensordict["observation"].device))

    return config, policy, source


def _baseline(name: str, flight_level: float) -> Any:
    from uavrl.training.baselines import StraightPolicy

    if name != "straight":
        raise UavrlError(f"policy must be straight, got {name!r}: to fly a trained policy give run=RUN_FOLDER.")
    return StraightPolicy(flight_level)


if __name__ == "__main__":
    main()
