"""The line that a person watches while a run goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

from tqdm import tqdm


class Progress:
    """Episodes, steps, outcome rates over the window, steps per second and time left.

    Args:
        episodes: how many there will be.
        window: how many the rates cover.
        enabled: whether anything is shown.
        done: episodes flown before (by the run that is resumed).
        steps: steps flown before.
    """

    def __init__(self, episodes: int, window: int, *, enabled: bool = True, done: int = 0, steps: int = 0) -> None:
        self._window = window
        self._bar = tqdm(
            total=episodes,
            initial=done,
            disable=not enabled,
            unit="ep",
            dynamic_ncols=True,
            mininterval=0.5 if sys.stderr.isatty() else 30.0,
            bar_format="{n_fmt}/{total_fmt} episodes |{bar:12}| {postfix} | {elapsed} gone, {remaining} left",
        )
        self._start = time.monotonic()
        self._first_step = steps

    def update(self, episodes: int, steps: int, rates: Mapping[str, float], mean_return: float) -> None:
        """Shows the state after ``episodes`` episodes and ``steps`` steps."""
        speed = (steps - self._first_step) / max(time.monotonic() - self._start, 1e-9)
        window = min(self._window, max(episodes, 1))
        self._bar.set_postfix_str(
            f"{steps:,} steps, {speed:.0f}/s | last {window}: success {rates['arrived']:.1%}, "
            f"collision {rates['collided']:.1%}, time-out {rates['timed_out']:.1%}, return {mean_return:.1f}",
            refresh=False,
        )
        self._bar.update(episodes - self._bar.n)

    def close(self) -> None:
        """Leaves the line as it is."""
        self._bar.close()
