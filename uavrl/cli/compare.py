"""``uavrl-compare A B``: flies two policies in the same tasks until it is clear which one succeeds more often."""

from __future__ import annotations

import json
import math
import multiprocessing
import re
import shlex
import signal
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import yaml
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field

from uavrl.cli.command import explained
from uavrl.cli.processes import begin_worker
from uavrl.cli.suite import in_worlds_of, refuse_worlds
from uavrl.config import EvaluateConfig, validate
from uavrl.config.yaml_files import compose
from uavrl.errors import UavrlError
from uavrl.evaluation.policies import require_policy
from uavrl.evaluation.worlds import TRAINING
from uavrl.runs.episodes import LETTERS, outcomes_of, success_text, wilson
from uavrl.runs.progress_line import ProgressLine
from uavrl_onboard.cli.command import command
from uavrl_onboard.cli.help import About
from uavrl_onboard.cli.process import one_sentence
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.ranges import Count, Folder

if TYPE_CHECKING:
    from uavrl.evaluation.sequential import Comparison

SIDES = ("first", "second")
ABOUT = About(
    "uavrl-compare",
    "Flies two policies in the same tasks until it is clear which one succeeds more often.",
    [
        "best vfh_star row=dense",
        "runs/mine best",
        "'best guards=none' best row=busy",
        "mine/suite.json theirs/suite.json row=dense",
    ],
    "first second row tasks block error processes json",
)


@dataclass
class CompareConfig:
    """The keys of ``uavrl-compare``.

    Args:
        first: a policy, as in uavrl-evaluate policy=; the folder of a run or of an exported policy; or a JSON file that
            uavrl-evaluate wrote. Further keys of uavrl-evaluate may follow in the same quotes
        second: the policy to compare it with
        row: the scenario, one of those that uavrl-evaluate suite= takes
        tasks: when to stop if neither policy is better so far
        block: number of tasks between two looks at the outcomes
        error: probability of a wrong verdict, however early the comparison stops
        seed: seed of the tasks
        processes: number of processes that fly each policy
        json: file for the result; null: none
    """

    first: str | None = None
    second: str | None = None
    row: str = "held_out"
    tasks: Count = 500
    block: Count = 25
    error: Annotated[float, Field(gt=0, lt=0.5)] = 0.05
    seed: Annotated[int, Field(ge=0)] = 20_000
    processes: Annotated[int, Field(ge=1, le=512)] = 1
    json: Folder | None = None

    def __post_init__(self) -> None:
        """Check that there are two policies and a scenario."""
        if self.first is None or self.second is None:
            raise UavrlError("Name two policies to compare, for example: uavrl-compare best vfh_star row=dense.")
        _changes(self.row)


@command(ABOUT, CompareConfig)
def _main(settings: CompareConfig) -> None:
    if settings.json is not None:
        writable(Path(settings.json))
    comparison, outcomes = compare(settings)
    print(_sentences(settings, comparison, outcomes))
    if settings.json is not None:
        low, high = comparison.bounds
        result = {"row": settings.row, "seed": settings.seed, "error": settings.error, "better": comparison.better}
        result |= {"tasks": comparison.tasks, "difference": comparison.difference, "low": low, "high": high}
        result |= {name: {"policy": getattr(settings, name), "outcomes": outcomes[name]} for name in SIDES}
        with replacing(Path(settings.json)) as partial:
            partial.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Read the command line; the first two words that are no option and no KEY=VALUE name the policies."""
    sys.argv[1:] = _named(sys.argv[1:])
    _main()


def _named(words: Sequence[str]) -> list[str]:
    """Return the words of a command line with keys for the two policies.

    Examples:
        >>> _named(["best", "runs/gamma=0.98 guards=all", "row=dense"])
        ['first="best"', 'second="runs/gamma=0.98 guards=all"', 'row=dense']
    """
    names, found = iter(SIDES), []
    for word in words:
        is_policy = re.match(r"-|\w+=", word) is None
        name = next(names, None) if is_policy else None  # a third policy stays as it is, and is refused
        found.append(word if name is None else f"{name}={json.dumps(word, ensure_ascii=False)}")
    return found


def compare(settings: CompareConfig) -> tuple[Comparison, dict[str, str]]:
    """Fly both policies block by block, and stop when one is better or all tasks are flown.

    Returns:
        the comparison, and the outcomes of both policies in its tasks.
    """
    # Imported here: --help and a mistyped key answer without loading SciPy.
    from uavrl.evaluation.sequential import Comparison

    known: dict[str, str] = {}
    flying: dict[str, list[str]] = {}
    among: dict[str, str | None] = {}
    composed: dict[str, DictConfig] = {}
    for name in SIDES:
        side = str(getattr(settings, name))
        if (file := Path(side)).suffix == ".json":
            known[name], among[name] = _recorded(file, settings)
        else:
            flying[name] = _overrides(side, settings)
            composed[name] = _checked(flying[name])
    tasks = min([settings.tasks, *(len(outcomes) for outcomes in known.values())])
    among |= {name: _traffic(config, tasks, settings.processes) for name, config in composed.items()}
    _require_same_traffic(settings, among)
    found = Comparison(0, 0, 0, settings.error)
    with (
        _flights(flying, tasks, settings.processes) as flown,
        ProgressLine(tasks, "tasks", enabled=bool(flying)) as line,
    ):
        for end in [*range(settings.block, tasks, settings.block), tasks]:
            _wait_for(end, flown, line)
            outcomes = {name: known[name][:end] if name in known else flown[name].first(end) for name in SIDES}
            found = Comparison.of(outcomes["first"], outcomes["second"], settings.error)
            line.set(end)
            if found.better:
                break
    return found, outcomes


def _overrides(side: str, settings: CompareConfig) -> list[str]:
    """The overrides of ``uavrl-evaluate`` for one side."""
    try:
        name, *rest = shlex.split(side)
    except ValueError as error:
        raise UavrlError(f"{side!r} cannot be read ({error}): write POLICY, or 'POLICY KEY=VALUE …'.") from error
    refuse_worlds(rest, "row")
    if (Path(name) / "config.yaml").is_file():
        policy = f"run={json.dumps(name, ensure_ascii=False)}"
    else:
        require_policy(name)
        policy = f"policy={json.dumps(name, ensure_ascii=False)}"
    return [policy, *rest, *in_worlds_of(_changes(settings.row)), f"seed={settings.seed}", "progress=false"]


def _checked(overrides: list[str]) -> DictConfig:
    """What overrides compose: a mistake is told before anything flies."""
    try:
        return compose(*overrides, name="evaluate")
    except (HydraException, OmegaConfBaseException) as error:
        raise UavrlError(explained(error, "evaluate")) from error


def _changes(row: str) -> list[str]:
    """The overrides of a scenario of the suite."""
    from uavrl.evaluation.suite import scenarios

    return scenarios([row])[row]


def _world(overrides: Sequence[str], sensor: Collection[str]) -> dict[str, Any]:
    """What some overrides say about the world that was flown in, with some keys of the sensor; valleys come apart."""
    told = {}
    for each in overrides:
        key, _, value = each.lstrip("+~").partition("=")
        of_world = key in ("env", "randomize") or key.startswith(("env.", "randomize."))
        if (of_world and key != "env.lidar") or key in sensor:
            told[key] = yaml.safe_load(value)
    return {key: value for key, value in told.items() if (key, value) != ("randomize", "none")}


def _valleys(row: str) -> list[int]:
    """The valleys of a scenario of the suite."""
    config = _checked(["policy=straight", *in_worlds_of(_changes(row))])
    return list(config.env.world.seeds if config.valleys == TRAINING else config.valleys)


def _traffic(config: DictConfig, tasks: int, processes: int) -> str | None:
    """What the planes that a policy meets depend on, as they move with the steps of a process; None without planes."""
    vehicles = config.num_uavs
    if not OmegaConf.select(config, "env.world.planes") or not isinstance(vehicles, int):  # refused before it flies
        return None
    told = _traffic_text(min(vehicles, math.ceil(tasks / processes)), processes)
    return told if processes == 1 else f"{told} of uavrl-compare"  # which divides the tasks otherwise


def _traffic_text(vehicles: int, processes: int) -> str:
    return f"num_uavs={vehicles} and processes={processes}"


def _require_same_traffic(settings: CompareConfig, among: Mapping[str, str | None]) -> None:
    """Refuses to compare tasks one by one whose planes are not at the same places."""
    first, second = (among[name] for name in SIDES)
    if first and second and first != second:
        raise UavrlError(
            f"{settings.first} and {settings.second} do not meet the same planes, which depend on the vehicles of a "
            f"process: {first} against {second}. Evaluate both with the same num_uavs and processes=1."
        )


def _recorded(file: Path, settings: CompareConfig) -> tuple[str, str | None]:
    """The outcomes that ``uavrl-evaluate`` wrote, in a file of one scenario or of the suite, and their traffic."""
    among: str | None = None
    asked = _world(_changes(settings.row), sensor=_flaws(settings.row))
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
        result = result.get(settings.row, result)
        outcomes, seed = outcomes_of(result), result.get("seed", settings.seed)
        flown = {"env": result["env"]} if result.get("env") else {}
        flown |= _world(result.get("overrides") or [], sensor=_flaws(settings.row))
        valleys = result.get("valleys")
        if result.get("planes") and "num_uavs" in result:
            among = _traffic_text(result["num_uavs"], result.get("processes", 1))
    except OSError as error:
        raise UavrlError(f"{file} cannot be read ({error.strerror}): give a file that uavrl-evaluate wrote.") from error
    except (ValueError, AttributeError, KeyError, TypeError, yaml.YAMLError):
        outcomes, seed, flown, valleys = None, settings.seed, {}, None
    if not isinstance(outcomes, str) or not outcomes or set(outcomes) - set(LETTERS.values()):
        raise UavrlError(f"{file} holds no outcomes of {settings.row}: give a file that uavrl-evaluate wrote.")
    if flown and asked != flown:
        differ = sorted(key for key in asked.keys() | flown.keys() if asked.get(key) != flown.get(key))
        other = ", ".join(f"{key}={each[key]}" for key in differ for each in (flown, asked) if key in each)
        raise UavrlError(
            f"{file} was not flown in the worlds of row={settings.row}, which differ by {other}: choose its row."
        )
    if valleys is not None and valleys != (known := _valleys(settings.row)):
        raise UavrlError(
            f"{file} was not flown in the valleys of row={settings.row}, but in {_some(valleys)} instead of "
            f"{_some(known)}: choose its row, or evaluate it with suite=[{settings.row}]."
        )
    if seed != settings.seed:
        raise UavrlError(f"{file} holds tasks of seed {seed}, not {settings.seed}: add seed={seed}.")
    return outcomes, among


def _flaws(row: str) -> set[str]:
    """The keys of the sensor that a scenario of the suite sets; of the others each policy may have its own."""
    keys = {each.partition("=")[0] for each in _changes(row)}
    return {key for key in keys if key.startswith("perception.lidar.")}


def _some(valleys: Sequence[Any]) -> str:
    """A list of valleys, shortened."""
    told = [str(each) for each in valleys]
    return ", ".join(told if len(told) <= 4 else [*told[:3], "…", told[-1]])


class _Flights:
    """One policy that flies in processes of its own; with n of them, each has every n-th task.

    So the first tasks end first, whatever their number.
    """

    def __init__(self, overrides: list[str], tasks: int, processes: int) -> None:
        context, self._outcomes = multiprocessing.get_context("spawn"), dict[int, str]()
        self._started = list[tuple[SpawnProcess, Connection, range]]()
        for first in range(min(processes, tasks)):
            (ours, theirs), share = context.Pipe(duplex=False), range(first, tasks, processes)
            process = context.Process(target=_fly, args=(overrides, share, theirs), daemon=True)
            process.start()
            theirs.close()
            self._started.append((process, ours, share))

    def first(self, count: int) -> str:
        """Return the outcomes of tasks 0 to ``count - 1``, which have ended."""
        return "".join(self._outcomes[task] for task in range(count))

    def flown(self, count: int) -> int:
        """How many of tasks 0 to ``count - 1`` have ended: longer tasks are not left out."""
        return sum(task in self._outcomes for task in range(count))

    def awaited(self, count: int) -> list[Connection]:
        """Return what tells of those of tasks 0 to ``count - 1`` that have not ended."""
        return [
            told
            for _, told, share in self._started
            if any(task < count and task not in self._outcomes for task in share)
        ]

    def receive(self, ended: Connection) -> None:
        """Wait for one outcome and store it."""
        try:
            told = ended.recv()
        except EOFError as error:
            raise UavrlError("A flight's process was killed, often for want of memory: start it again.") from error
        if isinstance(told, str):
            raise UavrlError(told)
        self._outcomes[told[0]] = told[1]

    def stop(self) -> None:
        """End the processes."""
        for process, _, _ in self._started:
            process.kill()
        for process, _, _ in self._started:
            process.join()


def _wait_for(count: int, flights: dict[str, _Flights], line: ProgressLine) -> None:
    """Wait until all flights have flown tasks 0 to ``count - 1``; the line shows how many all have flown."""
    while flights and (done := min(each.flown(count) for each in flights.values())) < count:
        line.set(max(done, line.n))
        awaited = {told: each for each in flights.values() for told in each.awaited(count)}
        for told in wait(list(awaited), timeout=1.0):
            assert isinstance(told, Connection)
            awaited[told].receive(told)


@contextmanager
def _flights(flying: dict[str, list[str]], tasks: int, processes: int) -> Iterator[dict[str, _Flights]]:
    started: dict[str, _Flights] = {}
    try:
        for name, overrides in flying.items():
            started[name] = _Flights([*overrides, f"episodes={tasks}"], tasks, processes)
        yield started
    finally:
        for flight in started.values():
            flight.stop()


def _fly(overrides: list[str], tasks: Sequence[int], ended: Connection) -> None:
    """Send each outcome as ``(task, letter)``, or the sentence of an error."""
    begin_worker()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command itself is told, and ends this process
    from uavrl.cli.flights import chosen_policy, environment_of
    from uavrl.evaluation.rollout import episodes_as_they_end

    try:
        config = compose(*overrides, name="evaluate")
        settings = validate(config, EvaluateConfig)
        chosen = chosen_policy(settings, config, overrides)
        with environment_of(chosen, settings, {}, tasks) as env:
            for each in episodes_as_they_end(env, chosen.policy, tasks):
                ended.send((each.task, LETTERS[each.outcome]))
    except UavrlError as error:
        ended.send(str(error))
    except BrokenPipeError:  # nobody waits for the rest
        pass


def _sentences(settings: CompareConfig, comparison: Comparison, outcomes: dict[str, str]) -> str:
    """The rates, their difference and the verdict."""
    points = [f"{100 * value:+.1f}" for value in (comparison.difference, *comparison.bounds)]
    names = {name: str(getattr(settings, name)) for name in SIDES}
    width = max(map(len, names.values()))
    lines = []
    for name in SIDES:
        rate = wilson(outcomes[name].count("S"), comparison.tasks)
        lines.append(f"{names[name]:<{width}}  {success_text(rate, comparison.tasks)}")
    certain = f"{100 * (1 - settings.error):g} %"
    lines.append(f"Difference: {points[0]} points ({certain} confidence sequence {points[1]} to {points[2]}).")
    if comparison.better is None:
        lines.append(f"Neither policy is better in {settings.row} after {comparison.tasks} tasks.")
    else:
        other = SIDES[1 - SIDES.index(comparison.better)]
        least = min(abs(bound) for bound in comparison.bounds)
        lines.append(
            f"{names[comparison.better]} succeeds more often than {names[other]} in {settings.row}, by at least "
            f"{100 * least:.1f} points (error rate {100 * settings.error:g} %)."
        )
    return "\n".join(lines)


if __name__ == "__main__":
    with one_sentence():
        main()
