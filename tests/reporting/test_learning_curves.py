from __future__ import annotations

from tests.helpers.folders import ROOT, episodes
from uavrl.reporting.learning_curves import curves, moving_rates, steps_to
from uavrl.runs.episodes import Episode

REFERENCE = ROOT / "docs/data/bipedal/reference.json"


def test_rates_over_a_moving_window_and_a_threshold_over_a_full_one() -> None:
    steps, rates = moving_rates(episodes("caaat"), window=3)
    assert steps.tolist() == [10, 20, 30, 40, 50]
    assert rates["arrived"].tolist() == [0.0, 1 / 2, 2 / 3, 1.0, 2 / 3]
    assert rates["timed_out"].tolist() == [0.0, 0.0, 0.0, 0.0, 1 / 3]
    assert steps_to(episodes("accaaa"), 0.6, window=3) == 50
    assert steps_to(episodes("cccc"), 0.6, window=3) is None


def test_curves_of_seeds_that_end_at_different_episodes() -> None:
    def seed(outcomes: str, length: int) -> list[Episode]:
        names = {"a": "arrived", "c": "collided"}
        return [
            Episode(i + 1, length * (i + 1), names[o], float(i), length, 0, 0, 0, 0, 0, 0, 0, i)
            for i, o in enumerate(outcomes)
        ]

    found = curves([seed("ca", 10), seed("aaa", 5)], window=2)
    curve = found["success"]["episodes"]
    assert curve["seeds"] == [[[1, 2], [0.0, 0.5]], [[1, 2, 3], [1.0, 1.0, 1.0]]]
    assert [curve[name] for name in ("x", "mean", "low", "high")] == [[1, 2], [0.5, 0.75], [0.0, 0.5], [1.0, 1.0]]
    steps = found["return"]["steps"]
    assert steps["x"] == [10, 11, 12, 13, 14, 15], "from where both seeds have episodes to where the first ends"
    # The first seed has its first episode there, whose return is 0; the second its last two, or its last two but one.
    assert steps["low"] == [0.0] * 6 and steps["high"] == [0.5, 0.5, 0.5, 0.5, 0.5, 1.5]
