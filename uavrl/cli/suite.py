"""``uavrl-evaluate suite=…``: one policy in every scenario of the suite, and one table."""

import json
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uavrl.cli.logs import configure_logging
from uavrl.config import EvaluateConfig
from uavrl.config.yaml_files import compose_again
from uavrl.errors import UavrlError, was_interrupted
from uavrl.evaluation.overrides import output_name, result_overrides
from uavrl.evaluation.policies import file_of_policy, policy_folder
from uavrl.evaluation.worlds import TRAINING
from uavrl.runs.episodes import outcomes_of, success_text
from uavrl.runs.interrupts import interrupts_held_back
from uavrl.runs.machine import processors
from uavrl.runs.progress_line import ProgressLine
from uavrl.runs.trust import check_links
from uavrl.runs.weights import POLICY
from uavrl_onboard.files import replacing, writable

log = logging.getLogger(__name__)
OWN = ("suite", "output", "progress")  # keys of the suite, not of its evaluations
SPAWN = multiprocessing.get_context("spawn")
Evaluate = Callable[..., dict[str, Any]]  # as uavrl.cli.evaluate.evaluate
_counters: list[Any] = []  # of a process that flies scenarios, the one of tasks that have ended


def evaluate_suite(settings: EvaluateConfig, evaluate: Evaluate, overrides: list[str]) -> None:
    """Evaluates the scenarios, as many at a time as there are processors, and prints their table.

    Each has a file of its own; one that is there already, of the same policy and tasks, is not made again.
    ``suite.json`` has these and all others of the policy that lie beside them.
    """
    from uavrl.evaluation.suite import scenarios, suite_table

    kept = result_overrides(overrides, OWN)
    refuse_worlds(kept, "suite")
    every, chosen = scenarios("all"), scenarios(settings.suite or "all")
    configs = {name: _config(changes) for name, changes in chosen.items()}
    own_folder = output_name("suite", result_overrides(kept))
    if settings.run is not None and settings.output is None:
        check_links(Path(settings.run), [own_folder])
    folder = Path(settings.output or (Path(settings.run or ".") / own_folder))
    writable(folder / "suite.json")
    outputs = {name: folder / f"{name}.json" for name in every}
    told = {name: [*kept, *changes] for name, changes in every.items()}
    flown = {name: result for name in chosen if (result := _same(outputs[name], settings, told[name])) is not None}
    for name in flown:
        log.info("%s is there already", outputs[name])
    missing = {name: (configs[name], told[name], outputs[name]) for name in chosen if name not in flown}
    flown |= _evaluated(evaluate, missing, settings)
    results = {name: flown[name] for name in chosen}
    # The others are read last: another command may have written some meanwhile.
    found = {name: results.get(name) or _same(outputs[name], settings, told[name]) for name in every}
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


def _evaluated(
    evaluate: Evaluate, scenarios: Mapping[str, tuple[DictConfig, list[str], Path]], settings: EvaluateConfig
) -> dict[str, Any]:
    """The results of some scenarios, each in a process of its own; a line says how far all of them are."""
    results, ended, tasks = {}, SPAWN.Value("q", 0), len(scenarios) * settings.episodes
    with (
        _processes(min(processors(), max(len(scenarios), 1)), ended) as pool,
        ProgressLine(tasks, "tasks", enabled=settings.progress and tasks > 0) as line,
    ):
        with interrupts_held_back():
            futures = {name: pool.submit(_row, evaluate, *scenario) for name, scenario in scenarios.items()}
        for name, each in futures.items():
            try:
                results[name] = _result(each, lambda: line.set(ended.value))
            except BrokenProcessPool as error:
                raise UavrlError(
                    f"{name}: its process was killed, often for want of memory: start the same command again, which "
                    f"evaluates what is missing."
                ) from error
            except UavrlError as error:
                raise UavrlError(f"{name}: {error}") from error
            log.info("%s is evaluated", name)
    return results


def _result(future: Future[Any], meanwhile: Callable[[], None] = lambda: None) -> Any:
    """What a process has found; it is looked for each second, as a signal wakes only the thread that it comes to."""
    while not future.done():
        wait([future], timeout=1.0)
        meanwhile()
    meanwhile()
    return future.result()


@contextmanager
def _processes(count: int, ended: Any = None) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with this one; on an error they finish their evaluations first, on Ctrl-C they do not."""
    pool = ProcessPoolExecutor(count, SPAWN, _begin, (ended,))
    try:
        yield pool
    except BaseException as error:
        if was_interrupted(error):
            for process in multiprocessing.active_children():
                process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(ended: Any) -> None:
    """Prepare a process that flies scenarios; all such processes count the tasks that have ended in ``ended``."""
    begin_worker()
    _counters[:] = [ended]


def _row(evaluate: Evaluate, config: DictConfig, overrides: list[str], output: Path) -> dict[str, Any]:
    """One scenario, in a process that ``_begin`` prepared."""
    (ended,) = _counters

    def count() -> None:
        with ended.get_lock():
            ended.value += 1

    return evaluate(config, overrides, output, count)


def begin_worker() -> None:
    """Prepare a process that flies for a command: its log, and its end with that command."""
    configure_logging()
    logging.getLogger().setLevel(logging.WARNING)

    def end_with_parent() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGKILL)  # nobody waits for its result

    threading.Thread(target=end_with_parent, daemon=True).start()


def _same(output: Path, settings: EvaluateConfig, told: list[str]) -> dict[str, Any] | None:
    """The result in a file, if it is of these tasks and younger than the policy, else None."""
    try:
        result = json.loads(output.read_text(encoding="utf-8"))
        wanted = {"overrides": result_overrides(told), "episodes": settings.episodes, "seed": settings.seed}
        same = all(result[key] == value for key, value in wanted.items()) and _is_of_run(result, settings)
        result["outcomes"] = outcomes_of(result)  # which a file from before there were any tells by its flights
    except (OSError, ValueError, KeyError, TypeError):  # not there, something else, or damaged: it is made again
        return None
    return result if same and output.stat().st_mtime >= _changed(settings) else None


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
