"""``uavrl-evaluate suite=…``: one policy in every scenario of ``conf/suite.yaml``, and one table."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from uavrl.cli.command import FULL_ERROR
from uavrl.cli.policies import UNTOLD, checkpoint_path, name_of_output, policy_folder, told_apart, writable
from uavrl.configs import EvaluateConfig, conf_dir
from uavrl.configs.choices import did_you_mean
from uavrl.errors import UavrlError
from uavrl.files import replacing

log = logging.getLogger(__name__)
RATES = ("success", "collision", "time_out")
HOW = {"steps_per_arrival": ".0f", "median_clearance": ".2f"}  # arrivals flew, and how it is written
OWN = ("suite", "output", "progress")  # keys of the suite, not of its evaluations


def scenarios(asked: str | Sequence[str]) -> dict[str, list[str]]:
    """What each scenario asked for changes; ``"all"`` asks for every one.

    Raises:
        UavrlError: for a name that the suite does not have.

    Examples:
        >>> scenarios(["dense"])
        {'dense': ['env=static', 'env.world.obstacles=90']}
    """
    suite: Any = OmegaConf.to_container(OmegaConf.load(conf_dir() / "suite.yaml"))
    if asked == "all":
        return suite
    names = [asked] if isinstance(asked, str) else list(asked)
    for name in names:
        if name not in suite:
            known = f"suite must be all or some of {', '.join(suite)}, got {name!r}"
            raise UavrlError(known + did_you_mean(str(name), suite, ": "))
    return {name: suite[name] for name in names}


def evaluate_suite(settings: EvaluateConfig, overrides: list[str]) -> None:
    """Flies the scenarios, as many at a time as there are processors, and prints their table.

    Each is an evaluation of its own in a file of its own; one that is there already, of the same policy and tasks, is
    not flown again.
    """
    kept = told_apart(overrides, OWN)
    for override in kept:
        if override.split("=")[0] in ("valleys", "env") or override.startswith("env."):
            raise UavrlError(f"suite chooses the worlds, so {override!r} contradicts it: leave one of them out.")
    folder = _folder(settings, kept)
    chosen = scenarios(settings.suite)
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
    print(f"Written to {folder}")


def _folder(settings: EvaluateConfig, kept: list[str]) -> Path:
    name = name_of_output("suite", told_apart(kept, UNTOLD))
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
            told_apart(told, UNTOLD),
            settings.episodes,
            settings.seed,
        )
    except (ValueError, KeyError, TypeError):  # something else, or damaged: it is flown again
        return None
    return result if same and output.stat().st_mtime >= _changed(settings) else None


def _changed(settings: EvaluateConfig) -> float:
    """When the policy was written, 0 for one that learns nothing."""
    folder = policy_folder(settings.run, settings.policy)
    if folder is None:
        return 0.0
    from uavrl.training.exported import ABOUT, is_exported

    alone = settings.checkpoint is None and is_exported(folder)
    return (folder / ABOUT if alone else checkpoint_path(folder, settings.checkpoint)).stat().st_mtime


def suite_table(results: dict[str, dict[str, Any]]) -> str:
    """The rates of each scenario with their Wilson 95 % intervals, and how arrivals flew.

    Examples:
        >>> rate = {"rate": 0.5, "low": 0.4, "high": 0.6}
        >>> result = dict(success=rate, collision=rate, time_out=rate, steps_per_arrival=100.0, median_clearance=None)
        >>> print(suite_table({"dense": result}))
        scenario         success  (95 %)        collision  time-out  steps per arrival  clearance
        dense              50.0%  40.0–60.0         50.0%     50.0%                100          –
    """
    heads = f"{'collision':>12}{'time-out':>10}{'steps per arrival':>19}{'clearance':>11}"
    lines = [f"{'scenario':<13}{'success':>11}  {'(95 %)':<11}{heads}"]
    for name, result in results.items():
        success, collision, time_out = (result[key] for key in RATES)
        interval = f"{100 * success['low']:.1f}–{100 * success['high']:.1f}"
        steps, clearance = (_number(result[key], form) for key, form in HOW.items())
        rates = f"{success['rate']:>11.1%}  {interval:<11}{collision['rate']:>12.1%}{time_out['rate']:>10.1%}"
        lines.append(f"{name:<13}{rates}{steps:>19}{clearance:>11}")
    return "\n".join(lines)


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
