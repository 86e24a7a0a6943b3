"""``episodes.csv``: a row for each episode, and the rates over a window of them."""

from __future__ import annotations

import csv
import math
import os
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

from uavrl.errors import OtherFormat, UavrlError
from uavrl_onboard.files import naming, replacing
from uavrl_onboard.pluralize import pluralize

if TYPE_CHECKING:  # reports read episodes without torch
    from tensordict import TensorDictBase
    from torch import Tensor

OUTCOMES = ("arrived", "collided", "timed_out")
RATES = {"success": "arrived", "collision": "collided", "time_out": "timed_out"}
SAID = {outcome: name.replace("_", "-") for name, outcome in RATES.items()}  # success, collision, time-out
TERM = "return_"  # begins the column of what one term of the reward adds to the return
LETTERS = {"arrived": "S", "collided": "C", "timed_out": "T"}  # success, collision, time-out: an outcome in one letter


@dataclass(frozen=True)
class Episode:
    """One episode; lengths in metres, places 0 where the environment has none.

    The return is the environment's, where a transform scales the rewards that are learned from; ``terms`` are what each
    named term of the reward adds to it.
    """

    episode: int
    total_steps: int
    outcome: str
    episode_return: float
    steps: int
    start_x: float
    start_y: float
    start_z: float
    goal_x: float
    goal_y: float
    goal_z: float
    world_seed: int
    task: int
    terms: Mapping[str, float] = field(default_factory=dict, kw_only=True)

    @staticmethod
    def header(terms: Sequence[str] = ()) -> list[str]:
        """The column names, with one for each term."""
        return [field.name for field in fields(Episode)[:-1]] + [f"{TERM}{name}" for name in terms]

    def row(self, terms: Sequence[str] = ()) -> list[Any]:
        """The values of the columns of :meth:`header`."""
        return [getattr(self, name) for name in Episode.header()] + [self.terms.get(name, math.nan) for name in terms]

    @staticmethod
    def from_row(row: list[str], terms: Sequence[str] = ()) -> Episode:
        """Reads what :meth:`row` gave."""
        if len(row) != len(Episode.header(terms)):
            raise ValueError(f"expected rows of {len(Episode.header(terms))} columns, got {len(row)} in one")
        kinds = {"int": int, "float": float, "str": str}
        values = [kinds[str(each.type)](value) for each, value in zip(fields(Episode)[:-1], row, strict=False)]
        added = dict(zip(terms, map(float, row[len(values) :]), strict=True))
        return Episode(*values, terms=added)


def wilson(count: int, total: int) -> dict[str, float]:
    """A rate with its 95 % interval (Wilson 1927): ``rate``, ``low`` and ``high``, each in [0, 1].

    We do not use ``scipy.stats`` here, because importing it takes more than a second at the end of a command.
    """
    if not 0 <= count <= total or not total:
        raise ValueError(f"A rate needs at least one try and at most as many successes, got {count} of {total}.")
    rate, z = count / total, NormalDist().inv_cdf(0.975)
    middle = rate + z**2 / (2 * total)
    half = z * math.sqrt(rate * (1 - rate) / total + (z / (2 * total)) ** 2)
    low, high = ((middle + side) / (1 + z**2 / total) for side in (-half, half))
    return {"rate": rate, "low": low if count else 0.0, "high": high if count < total else 1.0}


def rate_text(rate: Mapping[str, float], count: int, unit: str = "task") -> str:
    """A rate of :func:`wilson` with its interval and the number of its tasks, as every command prints it.

    Examples:
        >>> rate_text(wilson(13, 16), 16)
        '81.2 % (95 % CI 57.0–93.4 %, 16 tasks)'
    """
    share, low, high = (100 * rate[key] for key in ("rate", "low", "high"))
    return f"{share:.1f} % (95 % CI {low:.1f}–{high:.1f} %, {pluralize(count, unit)})"


def success_text(rate: Mapping[str, float], count: int, unit: str = "task") -> str:
    """:func:`rate_text` of successes, with its name: the one way to print a result.

    Examples:
        >>> success_text(wilson(1, 1), 1, "training episode")
        'Success rate: 100.0 % (95 % CI 20.7–100.0 %, 1 training episode)'
    """
    return f"Success rate: {rate_text(rate, count, unit)}"


def rate_cell(rate: Mapping[str, float]) -> str:
    """A rate of :func:`wilson` in a table whose heading names ``%`` and the interval.

    Examples:
        >>> rate_cell(wilson(13, 16))
        '81.2 (57.0–93.4)'
    """
    share, low, high = (100 * rate[key] for key in ("rate", "low", "high"))
    return f"{share:.1f} ({low:.1f}–{high:.1f})"


def aligned(texts: Iterable[tuple[str, str]]) -> list[str]:
    """Names and texts as lines whose texts begin in one column.

    Examples:
        >>> aligned([("steps per success", "104.25")])
        ['steps per success                               104.25']
    """
    return [f"{name:<48}{text}" for name, text in texts]


def outcomes_of(result: Mapping[str, Any]) -> str | None:
    """How each task of an evaluation ended, a letter each; None where a file holds neither outcomes nor episodes.

    Examples:
        >>> outcomes_of({"flights": [{"task": 0, "outcome": "arrived"}, {"task": 1, "outcome": "timed_out"}]})
        'ST'
    """
    if "outcomes" in result or "flights" not in result:
        return result.get("outcomes")
    return "".join(LETTERS[flight["outcome"]] for flight in result["flights"])


def outcome(last: TensorDictBase) -> str:
    """How an episode ended, from what came after its last step."""
    return "arrived" if last["arrived"].item() else "collided" if last["collided"].item() else "timed_out"


def split_episodes(batch: TensorDictBase) -> Iterator[TensorDictBase]:
    """Splits a flat batch of whole episodes at the ends that its ``("next", "done")`` marks."""
    ends = batch["next", "done"].reshape(-1).nonzero().reshape(-1).tolist()
    if not ends or ends[-1] != len(batch) - 1:
        raise ValueError(
            f"Expected whole episodes, got {len(batch)} steps, and the last one does not end an episode: collect with "
            f"trajs_per_batch=1, traj_format='cat'."
        )
    start = 0
    for end in ends:
        yield batch[start : end + 1]
        start = end + 1


def summarize(
    trajectory: TensorDictBase,
    episode: int,
    total_steps: int,
    reward_terms: Callable[[TensorDictBase, TensorDictBase], Mapping[str, Tensor]] | None = None,
) -> Episode:
    """One row from the steps of one whole episode; ``reward_terms`` gives the terms of its rewards, ``[T, 1]`` each."""
    first, last = trajectory[0], trajectory[-1]["next"]
    paid = float(last.get("episode_reward", trajectory["next", "reward"].double().sum()))
    places = [first.get(key, None) for key in ("position", "goal")]
    start, goal = ([0.0] * 3 if place is None else place.tolist() for place in places)
    where = [*start, *goal, int(first.get("world_seed", 0)), int(first["task"].item())]
    terms = reward_terms(trajectory, trajectory["next"]) if reward_terms is not None else {}
    added = {name: float(term.double().sum()) for name, term in terms.items()}
    return Episode(episode, total_steps, outcome(last), paid, len(trajectory), *where, terms=added)


def mean_terms(episodes: Collection[Episode]) -> dict[str, float]:
    """What each term of the reward adds to the mean return of some episodes, of the terms that all of them name."""
    names = next(iter(episodes)).terms if episodes else ()
    named = [name for name in names if all(name in episode.terms for episode in episodes)]
    return {name: sum(episode.terms[name] for episode in episodes) / len(episodes) for name in named}


def read_episodes(path: Path) -> list[Episode]:
    """Reads ``episodes.csv``; a last row cut off by a killed run is left out."""
    if not path.is_file():
        raise UavrlError(f"Expected the episodes of a run in {path} and found no such file: is it a run folder?")
    try:
        text = path.read_text(encoding="utf-8")
        rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
        if missing := [name for name in Episode.header() if rows and name not in rows[0]]:
            raise OtherFormat(path, f"column `{missing[0]}`")
        columns = Episode.header()
        terms = [name.removeprefix(TERM) for name in rows[0][len(columns) :]] if rows else []
        if rows[:1] != [Episode.header(terms)]:
            raise ValueError(f"expected it to start with the columns {','.join(columns)}")
        episodes = [Episode.from_row(row, terms) for row in rows[1:]]
        if not {e.outcome for e in episodes} <= set(OUTCOMES):
            raise ValueError(f"outcomes are {', '.join(OUTCOMES)} alone")
        if [e.episode for e in episodes] != list(range(1, len(episodes) + 1)):
            raise ValueError(f"expected the episodes 1 to {len(episodes)}, each once")
    except OtherFormat:
        raise
    except ValueError as error:
        raise UavrlError(f"{path} is damaged: {error}.") from error
    return episodes


class EpisodeLog:
    """Appends episodes to ``episodes.csv`` and keeps the rates over the last ``window`` of them.

    Its state is the number of rows: loading it cuts the file back to where the checkpoint was made.
    """

    def __init__(self, path: Path, window: int = 500) -> None:
        self.path = path
        self.window = window
        self.count = 0
        self._recent: deque[Episode] = deque(maxlen=window)
        self._terms: list[str] = []  # those that the file has columns for
        if not path.exists():
            self._rewrite([], [])

    def _rewrite(self, episodes: list[Episode], terms: list[str]) -> None:
        self._terms = terms
        with replacing(self.path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            rows = [Episode.header(terms), *(episode.row(terms) for episode in episodes)]
            csv.writer(file, lineterminator="\n").writerows(rows)

    def add(self, episode: Episode) -> None:
        """Writes one row; the first one decides which terms there are columns for."""
        if self.count == 0 and episode.terms:
            self._rewrite([], list(episode.terms))
        with naming(self.path), self.path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow(episode.row(self._terms))
            file.flush()
            os.fsync(file.fileno())  # a checkpoint must never know more episodes than the file
        self.count += 1
        self._recent.append(episode)

    def rates(self) -> dict[str, float]:
        """Share of each outcome over the window; zeros before the first episode."""
        total = max(len(self._recent), 1)
        return {name: sum(e.outcome == name for e in self._recent) / total for name in OUTCOMES}

    def mean_return(self) -> float:
        """Mean return over the window; 0 before the first episode."""
        return sum(e.episode_return for e in self._recent) / max(len(self._recent), 1)

    def mean_terms(self) -> dict[str, float]:
        """What each term of the reward adds to the mean return over the window."""
        return mean_terms(self._recent)

    def state_dict(self) -> dict[str, Any]:
        """The number of rows."""
        return {"count": self.count}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Cuts the file back to the number of rows that the checkpoint knows."""
        episodes = read_episodes(self.path)
        if len(episodes) < state_dict["count"]:
            raise UavrlError(
                f"Expected at least {pluralize(state_dict['count'], 'episode')} in {self.path} and found "
                f"{len(episodes)}: the file does not belong to the checkpoint."
            )
        episodes = episodes[: state_dict["count"]]
        self._rewrite(episodes, list(episodes[0].terms) if episodes else [])
        self.count = len(episodes)
        self._recent = deque(episodes, maxlen=self.window)
