"""``uavrl-evaluate suite=…``: one policy in every scenario of the suite, and one table."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uavrl.cli.flights import (
    INPUTS,
    Evaluation,
    Job,
    chosen_policy,
    in_processes,
    jobs_of,
    shares_of,
    write_result,
)
from uavrl.config import EvaluateConfig, validate
from uavrl.config.yaml_files import compose_again
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import output_name, result_overrides
from uavrl.evaluation.policies import file_of_policy, policy_folder
from uavrl.evaluation.worlds import TRAINING
from uavrl.runs.episodes import outcomes_of, success_text
from uavrl.runs.machine import processors
from uavrl.runs.progress_line import ProgressLine
from uavrl.runs.trust import check_links
from uavrl.runs.weights import POLICY
from uavrl_onboard.files import replacing, writable

if TYPE_CHECKING:
    from uavrl.evaluation.shares import Share

log = logging.getLogger(__name__)
OWN = ("suite", "output", "progress")  # keys of the suite, not of its evaluations


def evaluate_suite(settings: EvaluateConfig, overrides: list[str]) -> None:
    """Evaluates the scenarios, as many at a time as there are processors, and prints their table.

    Each has a file of its own; one that is there already, of the same policy and tasks, is not made again.
    ``suite.json`` has these and all others of the policy that lie beside them.
    """
    from uavrl.evaluation.identity import inputs_digest
    from uavrl.evaluation.suite import scenarios, suite_table

    kept = result_overrides(overrides, OWN)
    refuse_worlds(kept, "suite")
    every, chosen = scenarios("all"), scenarios(settings.suite or "all")
    configs = {name: _config(changes) for name, changes in chosen.items()}

    @cache
    def inputs(name: str) -> str:
        return inputs_digest(configs[name] if name in configs else _config(every[name]), settings)

    own_folder = output_name("suite", result_overrides(kept))
    if settings.run is not None and settings.output is None:
        check_links(Path(settings.run), [own_folder])
    folder = Path(settings.output or (Path(settings.run or ".") / own_folder))
    writable(folder / "suite.json")
    outputs = {name: folder / f"{name}.json" for name in every}
    told = {name: [*kept, *changes] for name, changes in every.items()}

    def kept_result(name: str) -> dict[str, Any] | None:
        return _same(outputs[name], settings, told[name], lambda: inputs(name))

    flown = {name: result for name in chosen if (result := kept_result(name)) is not None}
    for name in flown:
        log.info("%s is there already", outputs[name])
    missing = {
        name: Evaluation(configs[name], told[name], outputs[name], inputs(name)) for name in chosen if name not in flown
    }
    flown |= _evaluated(missing, settings) if missing else {}
    results = {name: flown[name] for name in chosen}
    # The others are read last: another command may have written some meanwhile.
    found = {name: results.get(name) or kept_result(name) for name in every}
    rows = {name: result for name, result in found.items() if result is not None}
    known = {name: {k: value for k, value in result.items() if k != "flights"} for name, result in rows.items()}
    with replacing(folder / "suite.json") as partial:
        partial.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    print(suite_table(results))
    worst = min(results, key=lambda name: results[name]["success"]["rate"])
    hardest = success_text(results[worst]["success"], results[worst]["episodes"])
    print(f"Hardest scenario: {worst}. {hardest}. Written to {folder}")


def refuse_worlds(overrides: Sequence[str], chooser: str) -> None:
    """Refuse overrides that change the worlds which the key ``chooser`` of a command has chosen."""
    for override in overrides:
        name = override.lstrip("+~").split("=")[0]
        if name == "env.lidar":  # of the vehicle
            continue
        if name in ("valleys", "env", "randomize") or name.startswith(("env.", "randomize.")):
            raise UavrlError(f"{chooser} chooses the worlds, so {override!r} contradicts it: leave one of them out.")


def _config(changes: list[str]) -> DictConfig:
    """What Hydra composes for one scenario of this command."""
    hydra = HydraConfig.get()
    own = [override for override in hydra.overrides.task if override.lstrip("+").split("=")[0] not in OWN]
    return compose_again(*own, *in_worlds_of(changes), "progress=false", name=str(hydra.job.config_name))


def in_worlds_of(row: Sequence[str]) -> list[str]:
    """The overrides of an evaluation in a row of the suite: its environment has the valleys, unless the row has."""
    return [f"valleys={TRAINING}", *row]


def _evaluated(scenarios: Mapping[str, Evaluation], settings: EvaluateConfig) -> dict[str, Any]:
    """The results of some scenarios, as many processes at a time as there are processors; a line says how far all are.

    Raises:
        UavrlError: At the first error, which ends all; the scenarios that are complete then are kept.
    """
    results, tasks = dict[str, Any](), len(scenarios) * settings.episodes
    jobs = {name: _jobs(name, each, settings, len(scenarios)) for name, each in scenarios.items()}

    def complete(name: str, shares: list[Share]) -> None:
        results[name] = write_result(scenarios[name], settings, shares)
        log.info("%s is evaluated", name)

    again = "start the same command again, which evaluates what is missing."
    with ProgressLine(tasks, "tasks", enabled=settings.progress and tasks > 0) as line:
        in_processes(jobs, complete, line, most=processors(), threads=settings.threads, again=again)
    return results


def _jobs(name: str, scenario: Evaluation, settings: EvaluateConfig, scenarios: int) -> list[Job]:
    """The jobs of one of so many scenarios; of one process, it says itself what is wrong with it."""
    if settings.processes == 1:
        return [Job(scenario.config, scenario.overrides, range(settings.episodes))]
    try:
        own = validate(scenario.config, EvaluateConfig)
        chosen = chosen_policy(own, scenario.config, scenario.overrides)
        return jobs_of(scenario, chosen, own, shares_of(chosen, own, scenarios))
    except UavrlError as error:
        raise UavrlError(f"{name}: {error}") from error


def _same(output: Path, settings: EvaluateConfig, told: list[str], inputs: Callable[[], str]) -> dict[str, Any] | None:
    """The result in a file, if it is of these tasks and of this policy, LiDAR and version of uavrl, else None.

    A file from before results told what they depend on must be of the run that is named, and younger than the policy.
    """
    try:
        result = json.loads(output.read_text(encoding="utf-8"))
        wanted = {"overrides": result_overrides(told), "episodes": settings.episodes, "seed": settings.seed}
        same = all(result[key] == value for key, value in wanted.items())
        same = same and (result[INPUTS] == inputs() if INPUTS in result else _is_of_run(result, settings))
        same = same and (not result.get("planes") or _is_divided(result, settings))
        result["outcomes"] = outcomes_of(result)  # which a file from before there were any tells by its flights
    except (OSError, ValueError, KeyError, TypeError):  # not there, something else, or damaged: it is made again
        return None
    return result if same and (INPUTS in result or output.stat().st_mtime >= _changed(settings)) else None


def _is_divided(result: Mapping[str, Any], settings: EvaluateConfig) -> bool:
    """Whether as many processes have flown a result as are asked for: each of them has planes of its own."""
    if settings.processes is None:
        return True
    return int(result.get("processes", 1)) == min(settings.processes, settings.episodes)


def _is_of_run(result: Mapping[str, Any], settings: EvaluateConfig) -> bool:
    """Whether a result is of the run that is named; in a run's own folder all are, wherever that has been moved."""
    if settings.run is None or settings.output is None:
        return True
    return Path(result["run"]).resolve() == Path(settings.run).resolve()


def _changed(settings: EvaluateConfig) -> float:
    """When the policy or its statistics were written, 0 for one that no file holds."""
    folder = policy_folder(settings.run, settings.policy)
    if folder is None:
        files = [file_of_policy(str(settings.policy), settings.packages)]
        files += [Path(settings.vecnormalize)] if settings.vecnormalize is not None else []
        return max(0.0 if file is None else file.stat().st_mtime for file in files)
    if settings.checkpoint is None and POLICY.is_in(folder):
        return (folder / POLICY.json).stat().st_mtime
    from uavrl.runs.checkpoint import checkpoint_path

    return checkpoint_path(folder, settings.checkpoint).stat().st_mtime
