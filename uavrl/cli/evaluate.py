"""``uavrl-evaluate``: rolls out the policy of a run, or a baseline, in fixed tasks."""

import logging
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli.command import command, given_overrides
from uavrl.cli.flights import Evaluation, chosen_policy, fly, in_processes, jobs_of, shares_of, worlds_of, write_result
from uavrl.cli.suite import evaluate_suite
from uavrl.config import EvaluateConfig, validate
from uavrl.config.command_line import command_line, override
from uavrl.evaluation.overrides import PLAIN_KEYS, output_name, result_overrides
from uavrl.evaluation.policies import require_named, require_one
from uavrl.runs.progress_line import ProgressLine
from uavrl_onboard.files import writable
from uavrl_onboard.pluralize import pluralize

if TYPE_CHECKING:
    from uavrl.evaluation.shares import Share

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
        evaluate_suite(settings, given_overrides())
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


def evaluate(config: DictConfig, overrides: list[str], output: Path) -> dict[str, Any]:
    """Rolls out the tasks of one evaluation, and writes the result with the overrides that made it."""
    from uavrl.evaluation.worlds import worlds_text

    settings, one = validate(config, EvaluateConfig), Evaluation(config, overrides, output)
    chosen = chosen_policy(settings, config, overrides)
    writable(output)
    shares = shares_of(chosen, settings)
    if settings.progress:
        where = worlds_text({**worlds_of(chosen), **chosen.source})
        among = f" in {len(shares)} processes" if len(shares) > 1 else ""
        log.info("Flying %s%s in %s.", pluralize(settings.episodes, "task"), among, where)
    found: list[Share] = []
    with ProgressLine(settings.episodes, "episodes", enabled=settings.progress) as line:
        if len(shares) == 1:
            found.append(fly(chosen, settings, shares[0], line.add))
        else:
            jobs, again = jobs_of(one, chosen, settings, shares), "start it again, with fewer processes."
            most, threads = len(shares), settings.threads
            in_processes({"": jobs}, lambda _, each: found.extend(each), line, most=most, threads=threads, again=again)
    return write_result(one, settings, found)


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
