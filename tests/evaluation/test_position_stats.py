"""Where flights go, on literal places."""

from __future__ import annotations

import numpy as np
import pytest

from uavrl.envs.world import World, WorldConfig
from uavrl.evaluation.position_stats import PositionStats, position_texts, summarize_places


def test_percentiles_quarters_and_histogram_of_known_places() -> None:
    altitudes = np.arange(101) / 20  # 0, 0.05 … 5 m
    found = summarize_places(altitudes, altitudes / 5, 10 - altitudes)
    assert found["steps"] == 101
    assert found["altitude"] == {"p5": 0.25, "p50": 2.5, "p95": 4.75}
    assert found["wall_distance"] == pytest.approx({"p5": 5.25, "p50": 7.5, "p95": 9.75})
    assert found["height_quarters"] == [25 / 101, 25 / 101, 25 / 101, 26 / 101]
    assert found["altitude_histogram"] == {"low": 0.0, "step": 0.25, "counts": [5] * 20 + [1]}


def test_what_is_above_the_ceiling_below_the_ground_or_behind_a_wall_counts_where_it_left() -> None:
    found = summarize_places(np.array([-0.4, 6.0]), np.array([-0.1, 1.2]), np.array([-0.3, 2.0]))
    assert found["height_quarters"] == [0.5, 0.0, 0.0, 0.5]
    assert found["wall_distance"] == pytest.approx({"p5": 0.1, "p50": 1.0, "p95": 1.9})
    assert found["altitude_histogram"]["low"] == -0.5
    assert sum(found["altitude_histogram"]["counts"]) == 2


def test_no_steps_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one step"):
        summarize_places(np.zeros(0), np.zeros(0), np.zeros(0))


def test_each_valley_has_walls_and_a_ground_of_its_own() -> None:
    world = World(WorldConfig(seeds=(3, 4), size=(26.0, 20.0), obstacles=0))
    ceiling = world.config.ceiling
    local = np.array([[12.0, 0.0], [-3.0, -8.5], [0.0, 0.0]])  # 1 m, 1.5 m and 10 m from the edge
    for valley in world.places:
        places = PositionStats(world)
        for share, xy in zip((0.1, 0.6, 0.9), local, strict=True):
            ground = valley.ground.at(xy[None])[0]
            places.add(np.append(xy + valley.origin, ground + share * ceiling)[None])
        found = places.summary()
        assert found["height_quarters"] == pytest.approx([1 / 3, 0, 1 / 3, 1 / 3])
        assert found["wall_distance"] == pytest.approx({"p5": 1.05, "p50": 1.5, "p95": 9.15})


def test_a_legend_is_beside_numbers_with_slashes() -> None:
    found = summarize_places(np.array([1.0, 3.0]), np.array([0.2, 0.6]), np.array([5.0, 7.0]))
    assert position_texts(found) == {
        "altitude": "1.10 / 2.00 / 2.90 m (5th / 50th / 95th percentile)",
        "distance to the nearest edge of the valley": "5.10 / 6.00 / 6.90 m (5th / 50th / 95th percentile)",
        "share of time by height": "50 / 0 / 50 / 0 % (lowest / second / third / highest quarter)",
    }
