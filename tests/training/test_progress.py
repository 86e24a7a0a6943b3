"""What the line says of the time left."""

from __future__ import annotations

import pytest

from uavrl.training import progress
from uavrl.training.progress import Progress, steps_left
from uavrl.training.validation import Validated

RATES = {"arrived": 0.25, "collided": 0.5, "timed_out": 0.25}


class Clock:
    """A clock that is turned by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        monkeypatch.setattr(progress.time, "monotonic", lambda: self.now)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def shown(line: Progress, episodes: int, steps: int) -> str:
    line.update(episodes, steps, RATES, 12.0)
    return str(line._bar)


@pytest.mark.parametrize(("a_flight", "expected"), [(40.0, 15_000), (150.0, 15_000), (210.0, 21_000)])
def test_flights_are_expected_to_lengthen_to_half_of_the_longest(a_flight: float, expected: float) -> None:
    assert steps_left(100, a_flight, 300) == expected


def test_random_flights_and_the_compilation_say_nothing_of_the_time_left(clock: Clock) -> None:
    line = Progress(1000, 200, learning_starts=500, max_steps=300)
    clock.now = 2.0  # quick: nothing is learned
    assert "acting at random until step 500 | 400 steps | last 10: success 25.0 %" in shown(line, 10, 400)
    clock.now = 60.0  # compiled
    assert "time left not known yet" in shown(line, 20, 600)
    clock.now = 61.0
    assert "time left not known yet" in shown(line, 22, 800)
    clock.now = 71.0  # 1,000 steps in 10 s, of 150 a flight: 900 flights take 1,350 s
    assert "22:30 left | 1,800 steps, 100 steps/s" in shown(line, 100, 1800)


def test_while_a_controller_flies_the_time_left_is_known(clock: Clock) -> None:
    line = Progress(1000, 200, learning_starts=1000, demonstrated=True, last_step=3000)
    assert "the scripted controller flies | 1 episode |" in shown(line, 1, 100)
    for second in (1.0, 2.0, 6.0):  # the first update is compiled before the clock starts
        clock.now = second
        text = shown(line, int(second) + 1, 100 * int(second) + 100)
    assert " elapsed, 00:23 left | 7 episodes, 100 steps/s" in text


def test_the_speed_is_that_of_the_last_minute(clock: Clock) -> None:
    line = Progress(1000, 200)
    for second in range(0, 200):
        clock.now = float(second)
        text = shown(line, second + 1, 1 + (100 * second if second < 100 else 10_000 + 50 * (second - 100)))
    assert ", 50 steps/s |" in text


@pytest.mark.parametrize(
    ("limit", "left", "goal"),
    [
        ({"until_success": 0.85}, ", at most 24:36 left | 1,500 steps, 100 steps/s", "success 25.0 %, "),
        ({"last_step": 2500}, " elapsed, 00:10 left | 16 episodes, 100 steps/s", "success 25.0 %, "),
    ],
)
def test_a_run_that_ends_before_its_episodes_says_so(
    limit: dict[str, float], left: str, goal: str, clock: Clock
) -> None:
    line = Progress(1000, 200, **limit)
    for second, steps in ((0, 1), (5, 500), (15, 1500)):
        clock.now = float(second)
        text = shown(line, second + 1, steps)
    assert left in text and goal in text


def test_the_last_validation_stands_at_the_end_of_the_line(clock: Clock) -> None:
    line = Progress(1000, 200, until_success=0.85)
    assert "unseen" not in shown(line, 1, 100)
    line.validated = str(Validated(10_000, 20, 19))
    assert shown(line, 2, 200).endswith(" | unseen valleys: success 95.0 % of 20 tasks, 85 % ends the run")


def test_the_flight_that_makes_the_last_step_leaves_no_time(clock: Clock) -> None:
    line = Progress(1000, 200, last_step=2500)
    for second, steps in ((0, 1), (5, 500), (25, 2600)):
        clock.now = float(second)
        text = shown(line, second + 1, steps)
    assert text.startswith("2,500/2,500 steps |") and " 00:00 left" in text


@pytest.mark.parametrize(
    ("ended", "beginning"),
    [({"episodes": 1000, "last_step": 2500}, "2,500/2,500 steps |"), ({"episodes": 10}, "10/10 episodes |")],
)
def test_a_run_that_has_gone_further_than_asked_shows_its_end(ended: dict[str, int], beginning: str) -> None:
    assert str(Progress(window=200, done=16, steps=2600, **ended)._bar).startswith(beginning)
