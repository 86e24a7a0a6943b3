"""What a person reads of a run while it goes on: the progress line, and warnings of settings that learn little."""

import logging
import math
import sys
import time
from collections import deque
from collections.abc import Mapping

from tqdm import tqdm

from uavrl.config.settings import TrainConfig

log = logging.getLogger(__name__)
SPAN = 60.0  # s that the speed is measured over
SHORTEST = 3.0  # s from which on a speed says something


def steps_left(flights: int, steps_a_flight: float, max_steps: int) -> float:
    """About how many steps ``flights`` more will take.

    Flights that collide soon are short, and lengthen as a policy learns: the rest is taken to last half of
    ``max_steps`` on average, or as long as the last ones where that is longer.
    """
    return flights * max(steps_a_flight, max_steps / 2)


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
        guided: bool = False,
        max_steps: int = 300,
        last_step: int | None = None,
        until_success: float | None = None,
    ) -> None:
        self._window = window
        self._random_steps = learning_starts
        self._first = "the guide flies" if guided else "flying at random"
        self._max_steps = max_steps
        self._episodes = episodes
        self._by_steps = last_step is not None
        self._last_step = math.inf if last_step is None else last_step
        self._goal = "" if until_success is None else f" of {until_success:.0%}"
        self._at_most = "" if until_success is None else "at most "
        self._times: deque[tuple[float, int]] = deque()
        self._compiled = False
        self._before = (done, steps)
        self._total = episodes if last_step is None else last_step
        unit = "steps" if self._by_steps else "episodes"
        self._bar = tqdm(
            total=self._total,
            initial=self._gone(done, steps),
            disable=not enabled,
            dynamic_ncols=True,
            mininterval=0.5 if sys.stderr.isatty() else 30.0,
            bar_format=f"{{n:,}}/{{total:,}} {unit} |{{bar:12}}| {{elapsed}} gone{{postfix}}",
        )

    def update(self, episodes: int, steps: int, rates: Mapping[str, float], mean_return: float) -> None:
        """Shows the state after ``episodes`` episodes and ``steps`` steps."""
        beside = f"{episodes:,} episodes" if self._by_steps else f"{steps:,} steps"
        self._bar.set_postfix_str(
            f"{self._left(episodes, steps)} | {beside}{self._speed_text()} | "
            f"last {min(self._window, max(episodes, 1))}: success {rates['arrived']:.1%}{self._goal}, "
            f"collision {rates['collided']:.1%}, time-out {rates['timed_out']:.1%}, return {mean_return:.1f}",
            refresh=False,
        )
        self._bar.update(self._gone(episodes, steps) - self._bar.n)

    def _gone(self, episodes: int, steps: int) -> int:
        """What the bar fills with; tqdm forgets a total that is passed, as the last flight passes the last step."""
        return min(steps if self._by_steps else episodes, self._total)

    def _left(self, episodes: int, steps: int) -> str:
        if steps <= self._random_steps:
            return f"{self._first} until step {self._random_steps:,}"
        if self._compiled:  # the first updates are compiled meanwhile
            self._take(steps)
        self._compiled = True
        speed = self._speed()
        if speed is None:
            return "time left not known yet"
        done, before = self._before
        a_flight = (steps - before) / max(episodes - done, 1)
        left = min(steps_left(self._episodes - episodes, a_flight, self._max_steps), max(self._last_step - steps, 0))
        return f"{self._at_most}{tqdm.format_interval(left / speed)} left"

    def _take(self, steps: int) -> None:
        now = time.monotonic()
        self._times.append((now, steps))
        while now - self._times[0][0] > SPAN and len(self._times) > 2:
            self._times.popleft()

    def _speed(self) -> float | None:
        """Steps per second of late, or None."""
        if not self._times or (seconds := self._times[-1][0] - self._times[0][0]) < SHORTEST:
            return None
        return max(self._times[-1][1] - self._times[0][1], 1) / seconds

    def _speed_text(self) -> str:
        return "" if (speed := self._speed()) is None else f", {speed:.0f} steps/s"

    def close(self) -> None:
        """Leaves the line as it is."""
        self._bar.close()


def expected_steps(episodes: int, max_steps: int) -> int:
    """About how many steps random flights make: they end after 50, or after a sixth of many that they may take."""
    return max(episodes * min(max_steps, 50), episodes * max_steps // 6)


def warn_of_late_learning(settings: TrainConfig) -> None:
    """Before the run: it may end before learning starts."""
    learning_starts, episodes, steps = settings.algo.learning_starts, settings.trainer.episodes, settings.trainer.steps
    length = f"trainer.episodes={episodes}" if steps is None else f"trainer.steps={steps}"
    if settings.guided:  # whose flights are learned from at once
        if learning_starts >= min(episodes * settings.env.get("max_steps", 300) // 3, steps or math.inf):
            log.warning(
                "algo.learning_starts=%d: the scripted controller may fly the whole run, %s, and the policy "
                "nothing. Lower it, or choose a longer run.",
                learning_starts,
                length,
            )
        return
    if steps is not None and learning_starts >= steps:
        log.warning(
            "algo.learning_starts=%d: nothing is learned before, and the run ends by then, by trainer.steps=%d. Lower "
            "it, or choose a longer run.",
            learning_starts,
            steps,
        )
    elif learning_starts > (expected := expected_steps(episodes, settings.env.get("max_steps", learning_starts * 6))):
        log.warning(
            "algo.learning_starts=%d: nothing is learned before, and trainer.episodes=%d may be over by then, since "
            "random episodes take about %d steps together. Lower it, or choose a longer run.",
            learning_starts,
            episodes,
            expected,
        )


def warn_of_nothing_learned(settings: TrainConfig, steps: int, updates: int) -> None:
    """After the run: it ended before learning started."""
    if updates == 0:
        log.warning(
            "Nothing was learned: the run ended after %d steps, before its algo.learning_starts=%d. Lower it, or "
            "choose a longer run.",
            steps,
            settings.algo.learning_starts,
        )
