"""Lengths that a run's configuration gives as shares of the run, worked out."""

from collections.abc import Sequence
from typing import Any

from uavrl.errors import UavrlError

CLONING_STEPS = 30_000  # of a run that has no number of steps


def are_shares(interval: Sequence[float]) -> bool:
    """Whether two numbers are shares of a run; numbers of updates end after the first."""
    return interval[1] <= 1


def is_interval(interval: Sequence[float]) -> bool:
    """Whether these are two shares of a run or two whole numbers of updates, in ascending order.

    Examples:
        >>> [is_interval(each) for each in ((0.5, 1.0), (0, 200), (0.5, 1.5), (0.5, 200), (2, 1), (1,))]
        [True, True, False, False, False, False]
    """
    if len(interval) != 2 or not 0 <= interval[0] < interval[1]:
        return False
    return are_shares(interval) or all(float(end).is_integer() for end in interval)


def in_updates(interval: Sequence[float], updates: int) -> list[int] | None:
    """Two shares of a run as numbers of its updates; None for a run that makes too few to tell them apart.

    Examples:
        >>> in_updates((0.5, 1.0), 100_000)
        [50000, 100000]
    """
    start, end = (round(share * updates) for share in interval)
    return [start, end] if end > start and end > 1 else None


def work_out(
    algo: dict[str, Any], cloning: dict[str, Any], *, steps: int | None, updates_per_step: float, demonstrated: bool
) -> None:
    """Turns what is given as a share of the run into numbers, so that the run keeps them if it goes on for longer.

    A cloning phase without a number of steps lasts for all of the run. ``algo.actor_lr_decay`` counts the updates after
    it, or after the random steps at the start.

    Args:
        algo: settings of the algorithm, which are changed.
        cloning: settings of the cloning phase, which are changed.
        steps: of the run; None if only its episodes are known.
        updates_per_step: after the cloning phase.
        demonstrated: whether a demonstrator flies the first steps, from which the algorithm learns at once.

    Raises:
        UavrlError: for shares of a run of which it is not known how many updates it makes.
    """
    clones = cloning.get("_target_") is not None
    if clones and cloning.get("steps", 0) is None:
        cloning["steps"] = steps or CLONING_STEPS
    decay = algo.get("actor_lr_decay")
    if decay is None or not are_shares(decay):
        return
    if steps is None:
        raise UavrlError(
            f"algo.actor_lr_decay={[*decay]} are shares of the run, and a run that ends after so many episodes makes "
            "an unknown number of updates: give trainer.steps, or two numbers of updates."
        )
    before = cloning.get("steps", 0) if clones else 0 if demonstrated else algo.get("learning_starts", 0)
    algo["actor_lr_decay"] = in_updates(decay, int(max(steps - before, 0) * updates_per_step))
