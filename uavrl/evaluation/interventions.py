"""How often guards change what a policy asks for, and by how much."""

from collections.abc import Sequence
from typing import Any

import numpy as np

NEGLIGIBLE = 0.05  # m/s


def interventions(asked: np.ndarray, flown: np.ndarray) -> tuple[float, float | None]:
    """The share of steps in which guards changed the velocity, and by how much on average in these.

    Changes of up to 0.05 m/s do not count. The map changes the heading that the policy reads, and no velocity.

    Args:
        asked: the policy's velocities within their limits, ``[T, 3]`` in m/s.
        flown: those that were flown instead, likewise.

    Returns:
        The share, and the mean length of the change in m/s; None where no step was changed.

    Examples:
        >>> asked = np.array([[2.0, 0.0, 0.0]] * 4)
        >>> interventions(asked, np.array([[2.0, 0, 0], [1.99, 0, 0], [1.5, 0, 0], [2, 1, 0]]))
        (0.5, 0.75)
        >>> interventions(asked, asked)
        (0.0, None)
    """
    change = np.linalg.norm(flown - asked, axis=1)
    counted = change > NEGLIGIBLE
    return float(counted.mean()), float(change[counted].mean()) if counted.any() else None


def summarize_interventions(
    steps: Sequence[int], shares: Sequence[float | None], changes: Sequence[float | None]
) -> dict[str, Any]:
    """``guard_share`` and ``guard_change`` over all steps of several episodes; nothing where no guard flew.

    Args:
        steps: of each episode.
        shares: of each episode, as :func:`interventions` gives them.
        changes: likewise.

    Examples:
        >>> summarize_interventions([100, 300], [0.2, 0.0], [0.5, None])
        {'guard_share': 0.05, 'guard_change': 0.5}
        >>> summarize_interventions([100], [None], [None])
        {}
    """
    episodes = list(zip(steps, shares, changes, strict=True))
    flown = sum(count for count, share, _ in episodes if share is not None)
    if not flown:
        return {}
    changed = [(count * share, change) for count, share, change in episodes if share and change is not None]
    total = sum(weight for weight, _ in changed)
    mean = sum(weight * change for weight, change in changed) / total if total else None
    return {"guard_share": total / flown, "guard_change": mean}


def intervention_texts(share: float | None, change: float | None) -> dict[str, str]:
    """What was measured as text for a person, by its name; nothing where no guard flew.

    Examples:
        >>> intervention_texts(0.123, 0.451)
        {'steps in which guards change the velocity': '12.3 %, by 0.45 m/s on average'}
    """
    if share is None:
        return {}
    by = "" if change is None else f", by {change:.2f} m/s on average"
    return {"steps in which guards change the velocity": f"{100 * share:.1f} %{by}"}
