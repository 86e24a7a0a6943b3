"""``uavrl-evaluate``: flies fixed tasks with the policy of a run, or with a policy that learns nothing."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from uavrl.cli.command import command, given_overrides
from uavrl.cli.policies import choose, distinguishing, name_of_output, policy_folder, require_fit
from uavrl.cli.suite import evaluate_suite
from uavrl.configs import EvaluateConfig, checked
from uavrl.runs.files import replacing, writable


@command("evaluate")
def main(config: DictConfig) -> None:
    """Evaluates one policy, in one world or in all of the suite."""
    settings = checked(config, EvaluateConfig)
    if settings.suite is None:
        _evaluate(settings, config, given_overrides())
    else:
        evaluate_suite(settings, given_overrides())


def _evaluate(settings: EvaluateConfig, config: DictConfig, overrides: list[str]) -> None:
    folder = policy_folder(settings.run, settings.policy)
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    import torch

    from uavrl.envs.navigation import NavigationEnv
    from uavrl.flying.flight import fly
    from uavrl.flying.summary import reached, summarize, table
    from uavrl.flying.whereabouts import Whereabouts
    from uavrl.training.arithmetic import multiplied_by
    from uavrl.training.factory import make_device, make_env

    torch.set_num_threads(settings.threads)
    chosen = choose(settings, config, overrides, folder, make_device(settings.device))
    if folder is not None:
        chosen.source["run"] = settings.run or f"policy={settings.policy}"
    output = _output(settings, overrides)
    told = {"seed": settings.seed, "env": chosen.choices.get("env", ""), "overrides": distinguishing(overrides)}
    count = min(settings.num_uavs, settings.episodes)
    if "world" in chosen.env:
        told["valleys"] = list(chosen.env.world.seeds)
        told["planes"] = chosen.env.world.planes
        told["num_uavs"] = count  # planes move with the steps of all
    offered: dict[str, Any] = {"packages": settings.packages, "seed": settings.seed, "num_uavs": count}
    with multiplied_by(settings.products, settings.threads) as told["products"]:
        env = make_env(chosen.env, chosen.perception, measure_clearance=True, **offered)
        try:
            require_fit(chosen, env)
            places = Whereabouts(env.base_env.world) if isinstance(env.base_env, NavigationEnv) else None
            watch = None if places is None else places.add
            flights = fly(env, chosen.policy, settings.episodes, watch=watch, progress=settings.progress)
        finally:
            env.close()
    result = summarize(flights) | ({} if places is None else {"whereabouts": places.summary()})
    known = [{key: value for key, value in asdict(flight).items() if value is not None} for flight in flights]
    with replacing(output) as partial:
        partial.write_text(json.dumps({**result, **told, **chosen.source, "flights": known}, indent=1) + "\n")
    print(table(result))
    who = f"run={settings.run}" if settings.run else f"policy={settings.policy}"
    who += f" 'packages=[{','.join(settings.packages)}]'" if settings.packages else ""
    then = f"Watch it fly: uavrl-replay {who}" if "world" in chosen.env else f"Its curves: uavrl-report {settings.run}"
    print(f"{reached(result)} Written to {output}. {then}")


def _output(settings: EvaluateConfig, overrides: list[str]) -> Path:
    """Where the result goes, found writable before anything is flown; what was changed stands in its name."""
    several = [] if settings.episodes == EvaluateConfig.episodes else [f"episodes={settings.episodes}"]
    name = name_of_output("evaluation", [*distinguishing(overrides), *several]) + ".json"
    return writable(Path(settings.output or (Path(settings.run or ".") / name)))


if __name__ == "__main__":
    main()
