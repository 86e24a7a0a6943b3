from __future__ import annotations

from pathlib import Path

from uavrl.reporting.learning_curves import moving_rates, plot, steps_to
from uavrl.training.episodes import Episode


def episodes(outcomes: str) -> list[Episode]:
    names = {"a": "arrived", "c": "collided", "t": "timed_out"}
    return [
        Episode(i + 1, 10 * (i + 1), names[o], 0.0, 10, 0.0, 0.0, 3.5, 5.0, 5.0, 3.5, 0, i)
        for i, o in enumerate(outcomes)
    ]


def test_rates_over_a_moving_window() -> None:
    steps, rates = moving_rates(episodes("caaat"), window=3)
    assert steps.tolist() == [10, 20, 30, 40, 50]
    assert rates["arrived"].tolist() == [0.0, 1 / 2, 2 / 3, 1.0, 2 / 3]
    assert rates["timed_out"].tolist() == [0.0, 0.0, 0.0, 0.0, 1 / 3]


def test_a_threshold_counts_only_over_a_full_window() -> None:
    assert steps_to(episodes("accaaa"), 0.6, window=3) == 50
    assert steps_to(episodes("cccc"), 0.6, window=3) is None


def test_the_plot_is_drawn(tmp_path: Path) -> None:
    plot({"one": episodes("caaat")}, tmp_path / "curves.png", window=3)
    assert (tmp_path / "curves.png").stat().st_size > 5000
