"""``uavrl-evaluate``: flies fixed tasks with the policy of a run, or with a policy that learns nothing."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from uavrl.cli.command import command, given_overrides
from uavrl.cli.policies import (
    UNTOLD,
    baseline,
    load_policy,
    name_of_output,
    policy_folder,
    told_apart,
    with_overrides,
    writable,
)
from uavrl.cli.suite import evaluate_suite
from uavrl.configs import EvaluateConfig, to_dataclass
from uavrl.configs.walker import BipedalConfig
from uavrl.errors import UavrlError
from uavrl.files import replacing

if TYPE_CHECKING:
    from uavrl.configs import TrainConfig


@command("evaluate")
def main(config: DictConfig) -> None:
    """Evaluates one policy, in one world or in all of the suite."""
    settings: EvaluateConfig = to_dataclass(config)
    if settings.suite is None:
        _evaluate(settings, config, given_overrides())
    else:
        evaluate_suite(settings, given_overrides())


def _evaluate(settings: EvaluateConfig, config: DictConfig, overrides: list[str]) -> None:
    folder = policy_folder(settings.run, settings.policy)
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    import torch

    from uavrl.training.arithmetic import multiplied_by
    from uavrl.training.factory import make_device

    torch.set_num_threads(settings.threads)
    device = make_device(settings.device)
    env_config, perception = settings.env, settings.perception
    if folder is not None:
        run_config, policy, source = load_policy(folder, settings.checkpoint, device)
        source["run"] = settings.run or f"policy={settings.policy}"
        changed: TrainConfig = to_dataclass(with_overrides(run_config, config, overrides))
        env_config, perception = changed.env, changed.perception
    else:
        _only_in_the_valley(env_config, "policy")
        policy, source = baseline(str(settings.policy), env_config.world.flight_level), {"policy": settings.policy}
    output = _output(settings, overrides)
    if settings.valleys is not None:
        _only_in_the_valley(env_config, "valleys")
        env_config = replace(env_config, world=replace(env_config.world, seeds=settings.valleys))
    told = {"seed": settings.seed, "env": env_config.name, "overrides": _telling(overrides)}
    if not isinstance(env_config, BipedalConfig):
        told["valleys"] = list(env_config.world.seeds)
        told["planes"] = env_config.world.planes
        told["num_uavs"] = min(settings.num_uavs, settings.episodes)  # planes move with the steps of all
    fly = _walk if isinstance(env_config, BipedalConfig) else _fly
    with multiplied_by(settings.products, settings.threads) as told["products"]:
        result, text = fly(settings, env_config, perception, policy, {**told, **source})
    with replacing(output) as partial:
        partial.write_text(json.dumps(result, indent=1) + "\n")
    print(text)
    print(f"Written to {output}")


def _only_in_the_valley(env: Any, key: str) -> None:
    if isinstance(env, BipedalConfig):
        raise UavrlError(f"{key} is for the valley, and the environment is {env.name}: leave {key} out.")


def _fly(
    settings: EvaluateConfig, env_config: Any, perception: Any, policy: Any, told: dict[str, Any]
) -> tuple[dict[str, Any], str]:
    """What goes into the file, and onto the screen."""
    from uavrl.training.evaluation import fly, summarize_flights, table
    from uavrl.training.factory import make_env
    from uavrl.training.whereabouts import Whereabouts

    count = min(settings.num_uavs, settings.episodes)
    env = make_env(env_config, perception, seed=settings.seed, num_uavs=count, measure_clearance=True)
    try:
        places = Whereabouts(env.base_env.world)
        flights = fly(env, policy, settings.episodes, watch=places.add, progress=settings.progress)
    finally:
        env.close()
    result = {**summarize_flights(flights), "whereabouts": places.summary()}
    return {**result, **told, "flights": [asdict(flight) for flight in flights]}, table(result)


def _walk(
    settings: EvaluateConfig, env_config: Any, perception: Any, policy: Any, told: dict[str, Any]
) -> tuple[dict[str, Any], str]:
    from uavrl.training.factory import make_env
    from uavrl.training.walks import summarize_walks, walk, walk_table

    env = make_env(env_config, perception, seed=settings.seed)
    try:
        walks = walk(env, policy, settings.episodes, progress=settings.progress)
    finally:
        env.close()
    result = summarize_walks(walks)
    return {**result, **told, "flights": [asdict(each) for each in walks]}, walk_table(result)


def _output(settings: EvaluateConfig, overrides: list[str]) -> Path:
    """Where the result goes, found writable before anything is flown; what was changed stands in its name."""
    several = [] if settings.episodes == EvaluateConfig.episodes else [f"episodes={settings.episodes}"]
    name = name_of_output("evaluation", [*_telling(overrides), *several]) + ".json"
    return writable(Path(settings.output or (Path(settings.run or ".") / name)))


def _telling(overrides: list[str]) -> list[str]:
    """Those overrides that tell which tasks were flown by what, beside how many."""
    return told_apart(overrides, UNTOLD)


if __name__ == "__main__":
    main()
