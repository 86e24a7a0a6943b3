"""Evaluations of a command, each in one process or divided among several."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from uavrl.cli.processes import as_complete, count_task, counter, processes, submit_all, value_of
from uavrl.config import EvaluateConfig, validate
from uavrl.config.yaml_files import register_resolvers
from uavrl.errors import UavrlError
from uavrl.evaluation.overrides import result_overrides
from uavrl.evaluation.policies import policy_folder
from uavrl.evaluation.policy_setup import PolicySetup, choose, require_fit
from uavrl.runs.interrupts import interrupts_held_back
from uavrl.runs.machine import processors
from uavrl.runs.progress_line import ProgressLine
from uavrl.runs.provenance import processor, versions
from uavrl_onboard.files import replacing

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

    from uavrl.evaluation.shares import Share


INPUTS = "inputs_sha256"  # the key of a result under which it tells what it depends on


class Evaluation(NamedTuple):
    """One evaluation of a command.

    Attributes:
        config: of ``conf/evaluate.yaml``, composed.
        overrides: that composed it.
        output: the file of its result.
        inputs: a hash of what it depends on, which its result tells; None: it tells none.
    """

    config: DictConfig
    overrides: list[str]
    output: Path
    inputs: str | None = None


class Job(NamedTuple):
    """Tasks of an evaluation that one process flies."""

    config: DictConfig
    overrides: list[str]
    tasks: Sequence[int]


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


def worlds_of(chosen: PolicySetup) -> dict[str, Any]:
    """What a result says of the worlds in which a policy flies."""
    told: dict[str, Any] = {"env": chosen.choices.get("env", "")}
    if (world := chosen.env.get("world")) is not None:
        told |= {"valleys": list(world.seeds)} if world.VARIES else {}
        told["planes"] = world.planes
    return told


@contextmanager
def environment_of(
    chosen: PolicySetup, settings: EvaluateConfig, told: dict[str, Any], tasks: Sequence[int]
) -> Iterator[EnvBase]:
    """The environment of a policy at the first of some tasks, which is closed at the end.

    ``told`` gets what a result says of the environment.
    """
    from uavrl.evaluation.environment import make_env
    from uavrl.training.matmul import matmul_backend

    told |= worlds_of(chosen)
    count = min(settings.num_uavs, len(tasks))
    if "planes" in told:
        told["num_uavs"] = count  # planes move with the steps of all
    context: dict[str, Any] = {"packages": settings.packages, "seed": settings.seed, "num_uavs": count}
    context["tasks"] = tasks  # valleys that none of these needs are not built
    context |= chosen.env_options
    with matmul_backend(settings.matmul, settings.threads) as told["matmul"]:
        env = make_env(chosen.env, chosen.perception, measure_clearance=True, **context)
        try:
            require_fit(chosen, env)
            yield env
        finally:
            env.close()


def fly(chosen: PolicySetup, settings: EvaluateConfig, tasks: Sequence[int], count: Callable[[], None]) -> Share:
    """Roll out some tasks; ``count`` is called after each of them."""
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.evaluation.position_stats import PositionStats
    from uavrl.evaluation.rollout import rollout_episodes
    from uavrl.evaluation.shares import Share
    from uavrl.evaluation.summary import with_difficulty

    told: dict[str, Any] = {}
    with environment_of(chosen, settings, told, tasks) as env:
        base = env.base_env
        places = PositionStats(base.world) if isinstance(base, NavigationEnv) else None
        watch = None if places is None else places.add
        flights = rollout_episodes(env, chosen.policy, tasks, watch=watch, count=count)
        if isinstance(base, NavigationEnv):
            flights = with_difficulty(flights, base.difficulty([flight.task for flight in flights]))
        return Share(flights, None if places is None else places.measured(), {**told, **chosen.source})


def _fly(job: Job) -> Share:
    """:func:`fly`, in a process of its own."""
    register_resolvers()
    settings = validate(job.config, EvaluateConfig)
    return fly(chosen_policy(settings, job.config, job.overrides), settings, job.tasks, count_task)


def shares_of(chosen: PolicySetup, settings: EvaluateConfig, evaluations: int = 1) -> list[list[int]]:
    """The tasks of each process of one of so many evaluations; the maps of their valleys are kept then.

    Raises:
        UavrlError: Where several processes are asked for, and the environment cannot begin at any task.
    """
    from torchrl.envs import EnvBase

    from uavrl.config.build import TARGET, arguments, find_class
    from uavrl.envs.rules import WorldRules
    from uavrl.envs.world import map_places, places_of
    from uavrl.evaluation.shares import divided

    count, tasks = settings.processes or _fitting(settings, evaluations), range(settings.episodes)
    if min(count, len(tasks)) == 1:
        return [list(tasks)]
    kind = find_class(str(chosen.env[TARGET]), EnvBase, settings.packages)
    if "tasks" not in arguments(kind):
        if settings.processes is None:
            return [list(tasks)]
        raise UavrlError(
            f"{kind.__name__} takes no tasks, so an evaluation in it cannot be divided among processes: leave "
            f"processes out, or give its constructor an argument tasks."
        )
    world = chosen.env.get("world")
    if not isinstance(world, WorldRules):
        return divided([0 for _ in tasks], count)
    places = places_of(world, settings.seed, tasks)
    map_places(world, [number for number in sorted(set(places)) if world.map_rules(number) is not None])
    return divided(places, count)


def _fitting(settings: EvaluateConfig, evaluations: int) -> int:
    """One process for each processor, while each of them has a task for each of its vehicles."""
    return max(1, min(processors() // evaluations, math.ceil(settings.episodes / settings.num_uavs)))


def jobs_of(
    evaluation: Evaluation, chosen: PolicySetup, settings: EvaluateConfig, shares: Sequence[Sequence[int]]
) -> list[Job]:
    """The jobs of an evaluation; all multiply matrices by the same library."""
    from uavrl.training.matmul import matmul_backend

    with matmul_backend(settings.matmul, settings.threads) as name:
        config = OmegaConf.merge(evaluation.config, {"matmul": name})
    assert isinstance(config, DictConfig)
    return [Job(config, evaluation.overrides, tasks) for tasks in shares]


def in_processes(
    jobs: Mapping[str, Sequence[Job]],
    complete: Callable[[str, list[Share]], None],
    line: ProgressLine,
    *,
    most: int,
    threads: int,
    again: str,
) -> None:
    """Fly evaluations, and hand over the shares of each when it is complete.

    Args:
        jobs: of each evaluation, by its name, which an error begins with.
        complete: takes a name and the shares.
        line: shows the tasks that have ended.
        most: processes at a time.
        threads: of each process.
        again: what to do when a process was killed.
    """
    ended = counter()
    killed = f"A process that was flying was killed, often for want of memory: {again}"
    with processes(max(1, min(most, sum(map(len, jobs.values())))), killed, ended, threads=threads) as pool:
        with interrupts_held_back():
            futures, started = submit_all(pool, _fly, jobs)
        for name, shares in as_complete(futures, started, lambda: line.set(value_of(ended))):
            complete(name, shares)


def write_result(evaluation: Evaluation, settings: EvaluateConfig, shares: Sequence[Share]) -> dict[str, Any]:
    """Write the result of an evaluation, with the overrides that made it, and return it."""
    from uavrl.evaluation.shares import merged

    told: dict[str, Any] = {"seed": settings.seed, "env": "", "overrides": result_overrides(evaluation.overrides)}
    told |= {"versions": versions(), "processor": processor()}
    result = merged(shares, told)
    if evaluation.inputs is not None:
        result[INPUTS] = evaluation.inputs
    with replacing(evaluation.output) as partial:
        partial.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result
