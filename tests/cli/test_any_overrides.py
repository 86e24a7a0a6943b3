"""Whatever is written on the command line ends in a start, or in one sentence; tests/check tries more of it."""

from __future__ import annotations

from hypothesis import given, settings

from tests.helpers.overrides import ANY, TOLD, before_the_world, ends_well


@settings(TOLD, max_examples=6)
@given(ANY)
def test_any_overrides_end_before_the_world_or_in_one_sentence(overrides: list[str]) -> None:
    ends_well(overrides, before_the_world)
