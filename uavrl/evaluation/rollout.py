"""Rolls out a policy in fixed, seeded tasks without exploration noise, and keeps how each of them ended."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, step_mdp

from uavrl.evaluation.interventions import interventions
from uavrl.evaluation.smoothness import action_change, yaw_reversals
from uavrl.exploration import deterministic
from uavrl.policy_protocol import Acts
from uavrl.runs.episodes import outcome
from uavrl.runs.progress_line import ProgressLine
from uavrl.transforms.guarded import FLOWN
from uavrl_onboard.vehicle import VEHICLE


@dataclass(frozen=True)
class EpisodeResult:
    """How one task ended; lengths in metres, None where the environment emits no ``clearance``."""

    task: int  #: its number, from 0
    outcome: str  #: arrived, collided or timed_out
    steps: int  #: until then
    world_seed: int | None = None  #: of the valley
    straight: float | None = None  #: the line from start to end
    flown: float | None = None  #: the path between them
    clearance: float | None = None  #: the least distance between the hull and the nearest thing
    episode_return: float | None = None  #: as the environment gives it, where lengths are None
    #: mean absolute change per step of each component of the action that was flown, of forward, left and up in m/s and
    #: of the yaw rate in rad/s, within the limits of the action; of other environments in their units. None in an
    #: episode of one step
    action_change: list[float] | None = None
    yaw_reversals: float | None = None  #: share of the steps that reverse the yaw rate, None in other environments
    guard_share: float | None = None  #: share of the steps in which guards changed the velocity, None without guards
    guard_change: float | None = None  #: mean change of the velocity in these steps in m/s, None without one
    #: mean width of the free space along the task's shortest way, in m (:class:`uavrl.envs.difficulty.Difficulty`)
    spacing: float | None = None
    detour: float | None = None  #: length of that way over that of the way without any obstacle

    @property
    def path_efficiency(self) -> float | None:
        """Straight line from start to end over the length flown, in (0, 1]; None for an episode that did not arrive.

        Its end is then not where it was to go: who circles, or hits the first thing in a straight line, saves nothing.
        """
        if self.outcome != "arrived" or self.straight is None or self.flown is None:
            return None
        return self.straight / max(self.flown, 1e-9)


@torch.no_grad()
def rollout(env: EnvBase, policy: Acts, state: TensorDictBase) -> Iterator[TensorDictBase]:
    """Steps of an environment of any batch size from ``env.reset()``'s state on, each with its ``"next"``, without end.

    The policy reads the environment's output and writes ``action``, without exploration noise. A vehicle that is done
    begins its next task when the step after is asked for.
    """
    while True:
        with deterministic():
            acted = policy(state)
        stepped = env.step(acted)
        yield stepped
        state = env.maybe_reset(step_mdp(stepped))


def speed_limit(env: EnvBase) -> float:
    """The limit of each component of the velocity in m/s; of other environments, which have none, the default."""
    return float(getattr(getattr(env, "base_env", env), "max_speed", VEHICLE.velocity_limit))


class EpisodeMeter:
    """Follows each of ``count`` vehicles from reset to done."""

    def __init__(self, count: int, max_speed: float = VEHICLE.velocity_limit) -> None:
        self._max_speed = max_speed
        self._steps = np.zeros(count, dtype=int)
        self._return, self._flown = np.zeros(count), np.zeros(count)
        self._start, self._clearance = np.zeros((count, 3)), np.full(count, np.inf)
        self._actions: list[list[np.ndarray]] = [[] for _ in range(count)]  # that were flown
        self._asked: list[list[np.ndarray]] = [[] for _ in range(count)]  # by the policy, where guards fly

    def step(self, stepped: TensorDictBase) -> list[EpisodeResult]:
        """Takes in one step of all vehicles; returns the episodes that it ended."""
        before, after = stepped.reshape(-1), stepped["next"].reshape(-1)
        if after.get("clearance", None) is not None:
            self._measure(before, after)
        new = self._steps == 0
        self._return = np.where(new, 0.0, self._return) + after["reward"].double().numpy()[:, 0]
        self._steps += 1
        flown = after.get(FLOWN, None)
        self._keep(self._actions, before["action"] if flown is None else flown)
        if flown is not None:
            self._keep(self._asked, before["action"])
        ended = np.flatnonzero(after["done"].numpy()[:, 0]).tolist()
        results = [self._result(i, after[i]) for i in ended]
        self._steps[ended] = 0
        for i in ended:
            self._actions[i], self._asked[i] = [], []
        return results

    @staticmethod
    def _keep(kept: list[list[np.ndarray]], actions: torch.Tensor) -> None:
        for own, action in zip(kept, actions.double().numpy().reshape(len(kept), -1), strict=True):
            own.append(action)

    def _measure(self, before: TensorDictBase, after: TensorDictBase) -> None:
        position, next_position = before["position"].double().numpy(), after["position"].double().numpy()
        new = self._steps == 0
        self._start[new] = position[new]
        self._clearance[new] = before["clearance"].numpy()[new, 0]
        self._clearance = np.minimum(self._clearance, after["clearance"].numpy()[:, 0])
        self._flown = np.where(new, 0.0, self._flown) + np.linalg.norm(next_position - position, axis=1)

    def _result(self, i: int, last: TensorDictBase) -> EpisodeResult:
        result = EpisodeResult(int(last["task"].item()), outcome(last), int(self._steps[i]))
        actions = np.stack(self._actions[i])
        if last.get("clearance", None) is None:
            paid = float(last.get("episode_reward", self._return[i]))
            return replace(result, episode_return=paid, action_change=action_change(actions))
        limits = np.full(actions.shape[-1], VEHICLE.yaw_rate_limit)
        limits[:3] = self._max_speed
        actions = actions.clip(-limits, limits)  # as the vehicle takes them
        share, change = None, None
        if self._asked[i]:
            asked = np.stack(self._asked[i]).clip(-limits, limits)
            share, change = interventions(asked[:, :3], actions[:, :3])
        return replace(
            result,
            guard_share=share,
            guard_change=change,
            action_change=action_change(actions),
            yaw_reversals=yaw_reversals(actions),
            world_seed=int(last["world_seed"].item()),
            straight=float(np.linalg.norm(last["position"].double().numpy() - self._start[i])),
            flown=float(self._flown[i]),
            clearance=max(float(self._clearance[i]), 0.0),
        )


def episodes_as_they_end(
    env: EnvBase, policy: Acts, tasks: int | Sequence[int], *, watch: Callable[[np.ndarray], None] | None = None
) -> Iterator[EpisodeResult]:
    """Roll out some tasks of the environment's seed, each once, and yield each when it ends.

    Args:
        env: any that emits ``arrived``, ``collided`` and ``task``, at its first tasks.
        policy: reads the environment's output, writes ``action``.
        tasks: their numbers, in the order in which the environment was made to fly them; or how many, from task 0 on.
        watch: called after each step with the positions ``[M, 3]`` in m of those vehicles whose tasks count.
    """
    numbers = _numbers(tasks)
    count, counted = env.batch_size.numel(), np.array(numbers)
    meter, left = EpisodeMeter(count, speed_limit(env)), len(numbers)
    state = env.reset()
    if state["task"].min() != counted[:count].min():
        raise ValueError("Expected an environment at its first task: call env.set_seed(seed) before rolling out again.")
    for stepped in rollout(env, policy, state):
        if watch is not None:
            after = stepped["next"]
            watch(after["position"].numpy()[np.isin(after["task"].reshape(-1).numpy(), counted)])
        ended = [each for each in meter.step(stepped) if each.task in numbers]
        yield from ended
        left -= len(ended)
        if not left:
            return


def _numbers(tasks: int | Sequence[int]) -> Sequence[int]:
    """The numbers of tasks that are named, or of the first so many."""
    return range(tasks) if isinstance(tasks, int) else tasks


def rollout_episodes(
    env: EnvBase,
    policy: Acts,
    tasks: int | Sequence[int],
    *,
    watch: Callable[[np.ndarray], None] | None = None,
    count: Callable[[], None] | None = None,
    progress: bool = False,
) -> list[EpisodeResult]:
    """Return what :func:`episodes_as_they_end` yields, in the order of ``tasks``.

    ``count`` is called after each of them; ``progress`` shows a line.
    """
    results, numbers = dict[int, EpisodeResult](), _numbers(tasks)
    with ProgressLine(len(numbers), "episodes", enabled=progress) as line:
        for each in episodes_as_they_end(env, policy, numbers, watch=watch):
            results[each.task] = each
            line.add(1)
            if count is not None:
                count()
    return [results[task] for task in numbers]
