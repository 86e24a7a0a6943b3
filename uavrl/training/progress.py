"""The progress line of a run, and warnings of settings with which little is learned."""

import logging
import math
import time
from collections import deque
from collections.abc import Mapping

from uavrl.config.settings import TrainConfig
from uavrl.errors import extras
from uavrl.runs.episodes import RATES
from uavrl.runs.progress_line import ProgressLine
from uavrl_onboard.pluralize import pluralize

with extras():
    from tqdm import tqdm

log = logging.getLogger(__name__)
SPAN = 60.0  # s that the speed is measured over
SHORTEST = 3.0  # s from which on a speed says something


def steps_left(episodes: int, steps_per_episode: float, max_steps: int) -> float:
    """About how many steps ``episodes`` more will take.

    Episodes lengthen as a policy learns: the rest is taken to last half of ``max_steps`` on average, or as long as the
    last ones where that is longer.
    """
    return episodes * max(steps_per_episode, max_steps / 2)


class Progress:
    """Episodes, steps, outcome rates over the window, steps per second and time left.

    The bar fills with episodes, or with steps where ``last_step`` is given.
    """

    def __init__(
        self,
        episodes: int,
        window: int,
        *,
        enabled: bool = True,
        done: int = 0,
        steps: int = 0,
        learning_starts: int = 0,
        demonstrated: bool = False,
        max_steps: int = 300,
        last_step: int | None = None,
        until_success: float | None = None,
    ) -> None:
        self._window, self._episodes, self._max_steps, self._learning_starts = (
            window,
            episodes,
            max_steps,
            learning_starts,
        )
        self._demonstrated = demonstrated
        self._by_steps = last_step is not None
        self._last_step = math.inf if last_step is None else last_step
        self._goal = "" if until_success is None else f", {100 * until_success:g} % ends the run"
        self._at_most = "" if until_success is None else "at most "
        self.validated = ""  # the last validation
        self._times: deque[tuple[float, int]] = deque()
        self._compiled = False
        self._before = (done, steps)
        self._total = episodes if last_step is None else last_step
        unit = "steps" if self._by_steps else "episodes"
        self._bar = ProgressLine(self._total, unit, done=self._gone(done, steps), enabled=enabled)

    def update(self, episodes: int, steps: int, rates: Mapping[str, float], mean_return: float) -> None:
        """Shows the state after ``episodes`` episodes and ``steps`` steps."""
        beside = pluralize(episodes, "episode") if self._by_steps else pluralize(steps, "step")
        left, speed = self._left(episodes, steps), self._speed()
        beside += "" if speed is None else f", {speed:.0f} steps/s"
        success, collision, time_out = (f"{100 * rates[name]:.1f} %" for name in RATES.values())
        unseen = f" | unseen valleys: {self.validated}{self._goal}" if self.validated else ""
        self._bar.set(
            self._gone(episodes, steps),
            f"{left} | {beside} | last {min(self._window, max(episodes, 1))}: success {success}, "
            f"collision {collision}, time-out {time_out}, return {mean_return:.1f}{unseen}",
        )

    def _gone(self, episodes: int, steps: int) -> int:
        """What the bar fills with; tqdm forgets a total that is passed, as the last episode passes the last step."""
        return min(steps if self._by_steps else episodes, self._total)

    def _left(self, episodes: int, steps: int) -> str:
        if steps <= self._learning_starts and not self._demonstrated:
            return f"acting at random until step {self._learning_starts:,}"
        if self._compiled:  # the first updates are compiled meanwhile
            now = time.monotonic()
            self._times.append((now, steps))
            while now - self._times[0][0] > SPAN and len(self._times) > 2:
                self._times.popleft()
        self._compiled = True
        speed = self._speed()
        if speed is None:
            return "the scripted controller flies" if steps <= self._learning_starts else "time left not known yet"
        done, before = self._before
        length = (steps - before) / max(episodes - done, 1)
        left = min(steps_left(self._episodes - episodes, length, self._max_steps), max(self._last_step - steps, 0))
        return f"{self._at_most}{tqdm.format_interval(left / speed)} left"

    def _speed(self) -> float | None:
        """Steps per second of late, or None."""
        if not self._times or (seconds := self._times[-1][0] - self._times[0][0]) < SHORTEST:
            return None
        return max(self._times[-1][1] - self._times[0][1], 1) / seconds

    def close(self) -> None:
        """Leaves the line as it is."""
        self._bar.close()


def warn_of_late_learning(settings: TrainConfig) -> None:
    """Before the run: it may end before learning starts."""
    learning_starts, episodes, steps = settings.algo.learning_starts, settings.trainer.episodes, settings.trainer.steps
    length = f"trainer.episodes={episodes}" if steps is None else f"trainer.steps={steps}"
    max_steps = settings.env.get("max_steps", 6 * learning_starts)
    # Random episodes end after about 50 steps, or after a sixth of many that they may take.
    expected = max(episodes * min(max_steps, 50), episodes * max_steps // 6)
    if settings.demonstrated:  # its episodes are learned from at once
        late = learning_starts >= min(episodes * settings.env.get("max_steps", 300) // 3, steps or math.inf)
        said = f"the scripted controller may act for the whole run, {length}, and the policy never"
    elif steps is not None and learning_starts >= steps:
        late, said = True, f"nothing is learned before, and the run ends by then, by {length}"
    else:
        late = learning_starts > expected
        said = (
            f"nothing is learned before, and trainer.episodes={episodes} may be over by then, since random episodes "
            f"take about {expected} steps together"
        )
    if late:
        log.warning("algo.learning_starts=%d: %s. Lower it, or choose a longer run.", learning_starts, said)


def warn_of_nothing_learned(settings: TrainConfig, steps: int, updates: int) -> None:
    """After the run: it ended before learning started."""
    if updates == 0:
        log.warning(
            "Nothing was learned: the run ended after %s, before its algo.learning_starts=%d. Lower it, or "
            "choose a longer run.",
            pluralize(steps, "step"),
            settings.algo.learning_starts,
        )
