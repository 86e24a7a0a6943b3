from __future__ import annotations

from pathlib import Path

import pytest

from uavrl.errors import UavrlError
from uavrl.reporting.learning_curves import moving_rates, plot, plot_returns, read_returns, steps_to
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


REFERENCE = Path(__file__).resolve().parents[2] / "docs/data/bipedal/reference.json"


def test_the_reference_curves_of_the_walker_are_whole() -> None:
    references = read_returns(REFERENCE)
    assert {name: len(returns) for name, returns in references.items()} == {"td3_fork": 3594, "td3_lg": 5000}
    assert references["td3_fork"][0] == -97.74


def test_returns_are_drawn_beside_references(tmp_path: Path) -> None:
    alone, beside = tmp_path / "alone.png", tmp_path / "beside.png"
    plot_returns({"ours": episodes("caaat")}, {}, alone, window=3)
    plot_returns({"ours": episodes("caaat")}, read_returns(REFERENCE), beside, window=100)
    assert 5000 < alone.stat().st_size < beside.stat().st_size


@pytest.mark.parametrize("content", ["", "[1, 2]", '{"td3": {"returns": [1.0]}}'])
def test_what_holds_no_returns_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "reference.json").write_text(content)
    with pytest.raises(UavrlError, match="a list episode_return"):
        read_returns(tmp_path / "reference.json")
