"""``uavrl-evaluate suite=…``: one policy in every scenario of the suite, and one table."""

import json
import logging
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from uavrl.cli.command import FULL_ERROR
from uavrl.cli.policies import distinguishing, file_of_policy, name_of_output, policy_folder
from uavrl.configs import EvaluateConfig
from uavrl.errors import UavrlError
from uavrl.runs.episodes import outcomes_of
from uavrl.runs.files import replacing, writable
from uavrl.runs.weights import POLICY

log = logging.getLogger(__name__)
OWN = ("suite", "output", "progress")  # keys of the suite, not of its evaluations


def evaluate_suite(settings: EvaluateConfig, overrides: list[str]) -> None:
    """Flies the scenarios, as many at a time as there are processors, and prints their table.

    Each is an evaluation of its own in a file of its own; one that is there already, of the same policy and tasks, is
    not flown again.
    """
    from uavrl.flying.suite import scenarios, suite_table
    from uavrl.flying.summary import reached

    kept = distinguishing(overrides, OWN)
    for override in kept:
        if override.split("=")[0] in ("valleys", "env") or override.startswith("env."):
            raise UavrlError(f"suite chooses the worlds, so {override!r} contradicts it: leave one of them out.")
    folder = _folder(settings, kept)
    chosen = scenarios(settings.suite or "all")
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        flown = [pool.submit(_scenario, settings, folder / f"{name}.json", kept, chosen[name]) for name in chosen]
        try:
            results = {name: each.result() for name, each in zip(chosen, flown, strict=True)}
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    told = {name: {key: value for key, value in result.items() if key != "flights"} for name, result in results.items()}
    with replacing(folder / "suite.json") as partial:
        partial.write_text(json.dumps(told, indent=1) + "\n")
    print(suite_table(results))
    worst = min(results, key=lambda name: results[name]["success"]["rate"])
    print(f"Hardest: {worst}. {reached(results[worst])} Written to {folder}")


def _folder(settings: EvaluateConfig, kept: list[str]) -> Path:
    name = name_of_output("suite", distinguishing(kept))
    folder = Path(settings.output or (Path(settings.run or ".") / name))
    writable(folder / "suite.json")
    return folder


def _scenario(settings: EvaluateConfig, output: Path, kept: list[str], changes: list[str]) -> dict[str, Any]:
    """The result of one scenario, flown unless its file has it."""
    told = [*kept, *changes]
    if output.is_file() and (result := _same(output, settings, told)) is not None:
        log.info("%s is there already", output)
        return result
    quoted = str(output).replace("\\", "\\\\").replace("'", "\\'")
    command = [sys.executable, "-m", "uavrl.cli.evaluate", *told, f"output='{quoted}'", "progress=false"]
    environment = {key: value for key, value in os.environ.items() if key != FULL_ERROR}  # set while a command runs
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise UavrlError(f"{output.stem}: {(done.stderr.strip().splitlines() or ['it ended without a word'])[-1]}")
    log.info("%s is flown", output.stem)
    return json.loads(output.read_text())


def _same(output: Path, settings: EvaluateConfig, told: list[str]) -> dict[str, Any] | None:
    """The result in a file, if it is of these tasks and younger than the policy, else None."""
    try:
        result = json.loads(output.read_text())
        same = (result["overrides"], result["episodes"], result["seed"]) == (
            distinguishing(told),
            settings.episodes,
            settings.seed,
        )
        result["outcomes"] = outcomes_of(result)  # which a file from before there were any tells by its flights
    except (ValueError, KeyError, TypeError):  # something else, or damaged: it is flown again
        return None
    return result if same and output.stat().st_mtime >= _changed(settings) else None


def _changed(settings: EvaluateConfig) -> float:
    """When the policy was written, 0 for one that no file holds."""
    folder = policy_folder(settings.run, settings.policy)
    if folder is None:
        named = file_of_policy(str(settings.policy), settings.packages)
        return 0.0 if named is None else named.stat().st_mtime
    if settings.checkpoint is None and POLICY.is_in(folder):
        return (folder / POLICY.json).stat().st_mtime
    from uavrl.training.policies import checkpoint_path

    return checkpoint_path(folder, settings.checkpoint).stat().st_mtime
