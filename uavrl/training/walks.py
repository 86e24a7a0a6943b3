"""Walks fixed, seeded courses without exploration noise and says how well it went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import trange

from uavrl.training.episodes import outcome
from uavrl.training.evaluation import Policy, outcome_rates, rate_lines


@dataclass(frozen=True)
class Walk:
    """How one course ended; the return is Gymnasium's, unscaled."""

    task: int
    outcome: str
    steps: int
    episode_return: float


@torch.no_grad()
def walk(env: EnvBase, policy: Policy, episodes: int, *, progress: bool = False) -> list[Walk]:
    """Walks courses 0 to ``episodes - 1`` of the environment's seed, each once, to its end.

    Args:
        env: of one vehicle; ``episode_reward`` is its own return where it emits one.
        policy: reads the environment's output, writes ``action``.
        episodes: number of courses.
        progress: show a progress line.

    Raises:
        ValueError: when the environment has given out its first course already.
    """
    walks: list[Walk] = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for task in trange(episodes, disable=not progress, unit="ep"):
            state, steps, paid = env.reset(), 0, 0.0
            if state["task"].item() != task:
                raise ValueError("Expected an environment at its first course: call env.set_seed(seed) before.")
            while steps == 0 or not state["done"].item():
                stepped, steps = env.step(policy(state)), steps + 1
                state = stepped["next"]
                paid += state["reward"].item()
            walks.append(Walk(task, outcome(state), steps, float(state.get("episode_reward", paid))))
    return walks


def summarize_walks(walks: Sequence[Walk]) -> dict[str, Any]:
    """Rates with Wilson 95 % intervals, returns and steps.

    Raises:
        ValueError: without walks.

    Examples:
        >>> result = summarize_walks([Walk(0, "arrived", 900, 310.0), Walk(1, "collided", 100, -90.0)])
        >>> result["success"]["rate"], result["mean_return"], result["median_return"], result["steps_per_episode"]
        (0.5, 110.0, 110.0, 500.0)
    """
    returns = [walk.episode_return for walk in walks]
    return {
        **outcome_rates([walk.outcome for walk in walks]),
        "mean_return": float(np.mean(returns)),
        "sd_return": float(np.std(returns)),
        "median_return": float(np.median(returns)),
        "steps_per_episode": float(np.mean([walk.steps for walk in walks])),
    }


def walk_table(result: dict[str, Any]) -> str:
    """The summary as text for a person."""
    labels = {
        "mean_return": "return, mean",
        "sd_return": "return, standard deviation",
        "median_return": "return, median",
        "steps_per_episode": "steps per episode",
    }
    return "\n".join([*rate_lines(result), *(f"{label:<46}{result[key]:>8.2f}" for key, label in labels.items())])
