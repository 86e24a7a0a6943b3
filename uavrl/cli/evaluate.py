"""``uavrl-evaluate``: rolls out the policy of a run, or a baseline, in fixed tasks."""

import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli.command import command, given_overrides
from uavrl.cli.suite import evaluate_suite
from uavrl.config import EvaluateConfig, validate
from uavrl.config.command_line import command_line, override
from uavrl.evaluation.overrides import PLAIN_KEYS, output_name, result_overrides
from uavrl.evaluation.policies import policy_folder, require_named, require_one
from uavrl.evaluation.policy_setup import PolicySetup, choose, require_fit
from uavrl.runs.provenance import processor, versions
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.pluralize import pluralize

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

log = logging.getLogger(__name__)
NOT_OF_A_REPLAY = (*PLAIN_KEYS, "policy", "num_uavs")  # named anew, or unknown to it


@command("evaluate")
def main(config: DictConfig) -> None:
    """Evaluates one policy, in one world or in all of the suite."""
    require_named(config)  # before all else: validating the environment loads torch
    with suppress(OmegaConfBaseException):  # a value that cannot be read is told by validate
        require_one(config.run, config.policy)
        if config.progress is True and (flown := config.run or config.policy):
            log.info("Loading %s ...", flown)
    settings = validate(config, EvaluateConfig)
    if settings.suite is not None:
        evaluate_suite(settings, evaluate, given_overrides())
        return
    output = _output(settings, given_overrides())
    result = evaluate(config, given_overrides(), output)
    from uavrl.evaluation.summary import table
    from uavrl.evaluation.worlds import worlds_text

    *details, success = table(result).splitlines()
    about = [f"Policy: {_policy_text(result)}", f"Worlds: {worlds_text(result)}"]
    print("\n".join([*details, *about, success]))
    who: dict[str, Any] = {"run": settings.run} if settings.run else {"policy": settings.policy}
    who |= {"packages": settings.packages} if settings.packages else {}
    watch = command_line(
        "uavrl-replay", *_own_folders(), *(override(key, each) for key, each in who.items()), *_typed()
    )
    report = command_line("uavrl-report", runs=settings.run)
    then = f"Watch it fly: {watch}" if "planes" in result else f"Its curves: {report}"
    print(f"Written to {output}. {then}")


def _policy_text(result: dict[str, Any]) -> str:
    """The policy of a result, for a person."""
    known = [result["label"]] if "label" in result else [str(result.get("policy", ""))]
    if isinstance(result.get("training_steps"), int):
        known.append(f"{result['training_steps']:,} training steps")
    return ", ".join(known) + (f" ({result['run']})" if "run" in result else "")


def chosen_policy(settings: EvaluateConfig, config: DictConfig, overrides: list[str]) -> PolicySetup:
    """The policy that the settings, which were read from ``config``, choose, with its environment's description."""
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    import torch

    from uavrl.evaluation.environment import make_device

    folder = policy_folder(settings.run, settings.policy)
    torch.set_num_threads(settings.threads)
    chosen = choose(settings, config, overrides, folder, make_device(settings.device))
    if folder is not None:
        chosen.source["run"] = settings.run or f"policy={settings.policy}"
    return chosen


@contextmanager
def environment_of(chosen: PolicySetup, settings: EvaluateConfig, told: dict[str, Any]) -> Iterator["EnvBase"]:
    """The environment of a policy at its first task, which is closed at the end; ``told`` gets a result's facts."""
    from uavrl.evaluation.environment import make_env
    from uavrl.training.matmul import matmul_backend

    told["env"] = chosen.choices.get("env", "")
    count = min(settings.num_uavs, settings.episodes)
    if "world" in chosen.env:
        if chosen.env.world.VARIES:
            told["valleys"] = list(chosen.env.world.seeds)
        told["planes"] = chosen.env.world.planes
        told["num_uavs"] = count  # planes move with the steps of all
    context: dict[str, Any] = {"packages": settings.packages, "seed": settings.seed, "num_uavs": count}
    context["tasks"] = range(settings.episodes)  # valleys that none of these needs are not built
    context |= chosen.env_options
    with matmul_backend(settings.matmul, settings.threads) as told["matmul"]:
        env = make_env(chosen.env, chosen.perception, measure_clearance=True, **context)
        try:
            require_fit(chosen, env)
            yield env
        finally:
            env.close()


def evaluate(
    config: DictConfig, overrides: list[str], output: Path, count: Callable[[], None] | None = None
) -> dict[str, Any]:
    """Rolls out the tasks of one evaluation, and writes the result with the overrides that made it.

    ``count`` is called after each task.
    """
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.evaluation.position_stats import PositionStats
    from uavrl.evaluation.rollout import rollout_episodes
    from uavrl.evaluation.summary import summarize, with_difficulty
    from uavrl.evaluation.worlds import worlds_text

    settings = validate(config, EvaluateConfig)
    chosen = chosen_policy(settings, config, overrides)
    writable(output)
    told: dict[str, Any] = {"seed": settings.seed, "env": "", "overrides": result_overrides(overrides)}
    told |= {"versions": versions(), "processor": processor()}
    with environment_of(chosen, settings, told) as env:
        if settings.progress:
            where = worlds_text({**told, **chosen.source})
            log.info("Flying %s in %s.", pluralize(settings.episodes, "task"), where)
        places = PositionStats(env.base_env.world) if isinstance(env.base_env, NavigationEnv) else None
        watch = None if places is None else places.add
        flights = rollout_episodes(
            env, chosen.policy, settings.episodes, watch=watch, count=count, progress=settings.progress
        )
        if isinstance(env.base_env, NavigationEnv):
            flights = with_difficulty(flights, env.base_env.difficulty([flight.task for flight in flights]))
    result = summarize(flights) | ({} if places is None else {"position_stats": places.summary()})
    known = [{key: value for key, value in asdict(flight).items() if value is not None} for flight in flights]
    result = {**result, **told, **chosen.source, "flights": known}
    with replacing(output) as partial:
        partial.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _own_folders() -> list[str]:
    """The option that names the folder of own yaml files; it stands before all that is KEY=VALUE."""
    sources = HydraConfig.get().runtime.config_sources
    return [word for each in sources if each.provider == "command-line" for word in ("--config-dir", each.path)]


def _typed() -> list[str]:
    """What a replay is told so that it shows the same world, as it was typed."""
    typed = HydraConfig.get().overrides.task
    return [each for each in typed if each.lstrip("+~").partition("=")[0] not in NOT_OF_A_REPLAY]


def _output(settings: EvaluateConfig, overrides: list[str]) -> Path:
    """Where the result goes; what was changed stands in its name."""
    several = [] if settings.episodes == EvaluateConfig.episodes else [f"episodes={settings.episodes}"]
    name = output_name("evaluation", [*result_overrides(overrides), *several]) + ".json"
    return Path(settings.output or (Path(settings.run or ".") / name))


if __name__ == "__main__":
    main()
