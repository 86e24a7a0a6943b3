"""Ways between obstacles of which points are known, by OMPL's RRT-Connect."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from uavrl.errors import UavrlError
from uavrl_onboard.guards.map.lines import Obstacles

APART = 0.1  # m between the points of a path


def pushed_out(points: np.ndarray, place: np.ndarray, kept: float) -> np.ndarray:
    """A place ``[3]`` moved away from ``points [P, 3]`` that are nearer than is kept, as far as three pushes lead.

    Examples:
        >>> pushed_out(np.array([[0.3, 0.0, 0.0]]), np.zeros(3), 0.5).round(3).tolist()
        [-0.2, 0.0, 0.0]
    """
    for _ in range(3 if len(points) else 0):
        apart = place - points
        distances = np.sqrt((apart * apart).sum(1))
        nearest = int(distances.argmin())
        if distances[nearest] >= kept:
            break
        place = place + (1.001 * kept / max(float(distances[nearest]), 1e-3) - 1) * apart[nearest]
    return place


def search(
    obstacles: Obstacles, start: np.ndarray, end: np.ndarray, box: np.ndarray, stride: float, tries: int, seed: int
) -> np.ndarray | None:
    """A way around obstacles, its corners ``[K, 3]`` from start to end; None where none is found.

    Source: Kuffner and LaValle (2000), RRT-Connect: two trees grow towards each other; as in OMPL (Sucan, Moll and
    Kavraki 2012), which also shortens the way at random. Another seed finds another way, the same seed the same.

    Args:
        obstacles: what the way must keep away from.
        start: ``[3]``, m.
        end: likewise.
        box: within which it lies, ``[2, 3]`` m.
        stride: m, the longest step of a tree.
        tries: times that a tree grows, at most.
        seed: of OMPL, above 0.

    Raises:
        UavrlError: where OMPL is not installed.
    """
    base, geometric, util = load_ompl()

    class StraightLines(base.MotionValidator):  # type: ignore[name-defined]
        def checkMotion(self, first: Any, second: Any) -> bool:
            ends = np.array([[each[0], each[1], each[2]] for each in (first, second)])
            return bool(obstacles.free(ends[:1], ends[1:])[0])

    def valid(state: Any) -> bool:
        place = np.array([[state[0], state[1], state[2]]])
        return bool(obstacles.free(place, place)[0])

    util.RNG.setSeed(seed)
    space, bounds = base.RealVectorStateSpace(3), base.RealVectorBounds(3)
    for axis, (low, high) in enumerate(box.T.tolist()):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    about = base.SpaceInformation(space)
    about.setStateValidityChecker(valid)
    about.setMotionValidator(StraightLines(about))
    about.setup()
    problem, ends = base.ProblemDefinition(about), (space.allocState(), space.allocState())
    for state, place in zip(ends, (start, end), strict=True):
        for axis in range(3):
            state[axis] = float(place[axis])
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(about)
    planner.setRange(stride)
    planner.setProblemDefinition(problem)
    planner.setup()
    left = iter(range(tries))
    planner.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))  # a time would not repeat
    if not problem.hasExactSolution():
        return None
    path, shorter = problem.getSolutionPath(), geometric.PathSimplifier(about)
    shorter.ropeShortcutPath(path)
    shorter.partialShortcutPath(path)
    shorter.reduceVertices(path)
    return np.array([[each[0], each[1], each[2]] for each in path.getStates()])


def load_ompl() -> tuple[Any, Any, Any]:
    """OMPL's modules base, geometric and util; it is told to be silent, as it warns of each new seed."""
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise UavrlError("policy=rrt_connect and policy=rrt_map need OMPL: pip install 'uavrl[planners]'.") from error
    util.setLogLevel(util.LogLevel.LOG_NONE)
    return base, geometric, util


def length(path: np.ndarray) -> float:
    """Of a way through ``[K, 3]``, m."""
    return float(np.sqrt((np.diff(path, axis=0) ** 2).sum(1)).sum())


def filled(corners: np.ndarray) -> np.ndarray:
    """A way through corners ``[K, 3]`` as points that are 0.1 m apart, or a little less.

    Examples:
        >>> filled(np.array([[0.0, 0, 0], [0.3, 0, 0]]))[:, 0].round(3).tolist()
        [0.0, 0.1, 0.2, 0.3]
    """
    pieces = []
    for first, second in pairwise(corners):
        count = max(int(np.ceil(length(np.stack([first, second])) / APART - 1e-9)), 1)
        pieces.append(first + np.arange(count)[:, None] / count * (second - first))
    return np.concatenate([*pieces, corners[-1:]])
