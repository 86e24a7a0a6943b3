"""A success rate is printed in one way, by one function."""

from __future__ import annotations

import re

import pytest
from scipy.stats import binomtest

from tests.helpers.folders import ROOT
from uavrl.runs.episodes import rate_cell, success_text, wilson


@pytest.mark.parametrize(
    ("count", "total", "text", "cell"),
    [
        (13, 16, "Success rate: 81.2 % (95 % CI 57.0–93.4 %, 16 tasks)", "81.2 (57.0–93.4)"),
        (0, 8, "Success rate: 0.0 % (95 % CI 0.0–32.4 %, 8 tasks)", "0.0 (0.0–32.4)"),
        (1200, 1200, "Success rate: 100.0 % (95 % CI 99.7–100.0 %, 1,200 tasks)", "100.0 (99.7–100.0)"),
    ],
)
def test_a_rate_as_text_and_as_a_cell(count: int, total: int, text: str, cell: str) -> None:
    rate = wilson(count, total)
    assert (success_text(rate, total), rate_cell(rate)) == (text, cell)


def test_the_interval_is_scipys() -> None:
    for total in (1, 2, 20, 500):
        for count in {0, 1, total // 3, total - 1, total}:
            scipys = binomtest(count, total).proportion_ci(0.95, method="wilson")
            rate = wilson(count, total)
            assert rate["rate"] == count / total
            assert (rate["low"], rate["high"]) == pytest.approx((scipys.low, scipys.high), abs=1e-14)


@pytest.mark.parametrize(("count", "total"), [(0, 0), (-1, 5), (6, 5), (0, -3)])
def test_no_rate_of_an_impossible_number_of_tries(count: int, total: int) -> None:
    with pytest.raises(ValueError, match=rf"at least one try and at most as many successes, got {count} of {total}"):
        wilson(count, total)


@pytest.mark.parametrize("folder", ["uavrl", "studies", "benchmarks", "examples", "docs/tutorials"])
def test_nothing_spells_a_rate_with_its_interval_itself(folder: str) -> None:
    """A rate that has an interval goes through ``rate_text`` or ``rate_cell``."""
    own = re.compile(r"Solved:|\{rate:\.|\[['\"]rate['\"]\]:|% \(\{low")
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if own.search(line) and path.name != "episodes.py"
    ]
    assert found == []
