"""How smoothly a policy acts: how much its action changes from one step to the next, and how often its yaw reverses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

YAW_RATE = 3  # its place in an action: after forward, left and up
NEGLIGIBLE = 0.05  # rad/s


def action_change(actions: np.ndarray) -> list[float] | None:
    """The mean absolute change of each component of the actions ``[T, A]`` from one step to the next.

    The mean is over the ``T - 1`` steps of an episode that have a step before them; a single step has no change.

    Examples:
        >>> action_change(np.array([[2.0, 0.0], [1.0, 0.5], [2.0, 0.5]]))
        [1.0, 0.25]
    """
    return np.abs(np.diff(actions, axis=0)).mean(0).tolist() if len(actions) > 1 else None


def yaw_reversals(actions: np.ndarray) -> float | None:
    """The share of steps at which the yaw rate of the actions ``[T, 4]`` reverses.

    A step reverses it if the yaw rates of this step and of the step before have opposite signs and are both greater
    than 0.05 rad/s in size. The share is of the ``T - 1`` steps of an episode that have a step before them.

    Examples:
        >>> rates = [0.5, -0.5, -0.04, 0.5, 0.2]  # the second reverses it; the fourth follows one that hardly turns
        >>> yaw_reversals(np.array([[2.0, 0.0, 0.0, rate] for rate in rates]))
        0.25
    """
    if len(actions) < 2:
        return None
    rates = actions[:, YAW_RATE]
    turns = np.where(np.abs(rates) > NEGLIGIBLE, np.sign(rates), 0.0)
    return float((turns[1:] * turns[:-1] < 0).mean())


def summarize_smoothness(
    steps: Sequence[int], changes: Sequence[list[float] | None], reversals: Sequence[float | None]
) -> dict[str, Any]:
    """``action_change`` and ``yaw_reversals`` over all steps of several episodes, each where there is one.

    Args:
        steps: of each episode.
        changes: each episode's :func:`action_change`.
        reversals: each episode's :func:`yaw_reversals`.

    Examples:
        >>> summarize_smoothness([2, 4, 1], [[0.25], [0.75], None], [0.0, 1 / 3, None])
        {'action_change': [0.625], 'yaw_reversals': 0.25}
    """
    measured = {"action_change": changes, "yaw_reversals": reversals}
    result: dict[str, Any] = {}
    for name, values in measured.items():
        pairs = [(value, count - 1) for value, count in zip(values, steps, strict=True) if value is not None]
        if pairs:
            result[name] = np.average([value for value, _ in pairs], axis=0, weights=[n for _, n in pairs]).tolist()
    return result


def change_text(change: Sequence[float], reversals: float | None) -> str:
    """A mean change of the action as text, with units where ``reversals`` says that it is one of ours.

    Examples:
        >>> change_text([0.21, 0.05, 0.02, 0.4], 0.06)
        '0.21 / 0.05 / 0.02 m/s, 0.40 rad/s'
        >>> change_text([0.1, 0.2], None)
        '0.10 / 0.20'
    """
    numbers = [f"{value:.2f}" for value in change]
    if reversals is None:
        return " / ".join(numbers)
    return f"{' / '.join(numbers[:YAW_RATE])} m/s, {numbers[YAW_RATE]} rad/s"


def smoothness_texts(change: Sequence[float] | None, reversals: float | None) -> dict[str, str]:
    """What was measured as text for a person, by its name; nothing where nothing was.

    Examples:
        >>> smoothness_texts([0.21, 0.05, 0.02, 0.4], 0.06)["mean change of the action per step"]
        '0.21 / 0.05 / 0.02 m/s (forward / left / up), 0.40 rad/s (yaw rate)'
    """
    if change is None:
        return {}
    name = "mean change of the action per step"
    if reversals is None:
        return {name: change_text(change, None)}
    velocity, _, turning = change_text(change, reversals).partition(", ")
    told = {name: f"{velocity} (forward / left / up), {turning} (yaw rate)"}
    return told | {"steps that reverse the yaw rate": f"{100 * reversals:.1f} %"}
