"""An evaluation in several processes: its tasks in shares, and one result of what the shares found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uavrl.evaluation.position_stats import summarize_places
from uavrl.evaluation.summary import summarize

if TYPE_CHECKING:
    from uavrl.evaluation.rollout import EpisodeResult


class Share(NamedTuple):
    """What one process found out.

    Attributes:
        flights: its tasks, in their order.
        places: ``[3, S]``, what :func:`uavrl.evaluation.position_stats.summarize_places` takes of its steps; None
            where positions are not measured.
        told: what a result says of the worlds and the policy.
    """

    flights: list[EpisodeResult]
    places: np.ndarray | None
    told: dict[str, Any]


def divided(places: Sequence[int], processes: int) -> list[list[int]]:
    """The tasks of an evaluation in shares whose sizes differ by one at most.

    Those of one place go together: a process builds the places of its own tasks alone.

    Args:
        places: of task 0, 1, …: numbers; the same where there is one place, or none.
        processes: how many shares there are, where there are as many tasks.

    Examples:
        >>> divided([1, 0, 1, 0, 1], 2)
        [[1, 3], [0, 2, 4]]
        >>> divided([0, 0, 0], 5)
        [[0], [1], [2]]
    """
    tasks, count = len(places), min(processes, len(places))
    by_place = sorted(range(tasks), key=places.__getitem__)
    return [sorted(by_place[share * tasks // count : (share + 1) * tasks // count]) for share in range(count)]


def merged(shares: Sequence[Share], told: Mapping[str, Any]) -> dict[str, Any]:
    """The result of an evaluation: the summary of all shares, as of one that has all tasks, and their facts.

    Args:
        shares: of one evaluation.
        told: what stands before what the shares tell.
    """
    flights = sorted((flight for share in shares for flight in share.flights), key=lambda flight: flight.task)
    result = summarize(flights)
    measured = [share.places for share in shares if share.places is not None]
    if measured:
        result["position_stats"] = summarize_places(*np.concatenate(measured, axis=1))
    result |= {**told, **shares[0].told}
    if "num_uavs" in result:
        result["num_uavs"] = max(share.told["num_uavs"] for share in shares)
    if len(shares) > 1:
        result["processes"] = len(shares)
    known = [{key: value for key, value in asdict(flight).items() if value is not None} for flight in flights]
    return {**result, "flights": known}
