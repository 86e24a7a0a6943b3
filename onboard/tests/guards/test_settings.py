"""``guards=`` as it is written, and what is said about a slip."""

from __future__ import annotations

from typing import Any

import pytest

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.command_line import join_guards
from uavrl_onboard.guards.settings import GuardSettings, ShieldSettings, guard_settings

ALL = ("map", "evasion", "shield")


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        (None, ("shield",)),
        ("all", ALL),
        ("none", ()),
        ("map", ("map",)),
        ([], ()),
        (["shield", "map"], ("map", "shield")),
        (["all"], ALL),
        ({"shield": {"margin": 0.2}}, ("shield",)),
        (["all", {"shield": {"margin": 0.2}}], ALL),
        ([{"shield": {"margin": 0.2}}, {"shield": {"lag": 0.1}}], ("shield",)),
    ],
)
def test_names_say_which_guards_are_on_and_settings_alone_change_the_policys(
    asked: Any, names: tuple[str, ...]
) -> None:
    default = GuardSettings(shield=ShieldSettings(time=1.5))
    found = guard_settings(asked, default)
    assert found.names == names
    if found.shield is not None and "margin" in str(asked):
        assert found.shield.margin == 0.2
        assert found.shield.time == (0.7 if "all" in asked else 1.5)
    assert guard_settings(found.plain(), GuardSettings.all() if len(names) == 3 else found) == found


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("typo", "There is no guard 'typo'; the guards are map, evasion, shield: write guards=all, guards=none, or a"),
        (["map", "typo"], "There is no guard 'typo'; the guards are map, evasion, shield"),
        ("shiled", "There is no guard 'shiled'; the guards are map, evasion, shield: did you mean shield"),
        (True, "There is no guard True; the guards are map, evasion, shield"),
        (12, "There is no guard 12; the guards are"),
        (["none", "map"], "guards cannot be none and map: write guards=all, guards=none, or a list"),
        (["all", {"typo": {"margin": 1}}], "There is no guard 'typo'"),
        (
            ["all", {"shield": {"margn": 1}}],
            "There is no key 'guards.shield.margn': did you mean guards.shield.margin",
        ),
        (["all", {"shield": {"margin": -1}}], "guards.shield.margin must be at least 0, got -1"),
        (["all", {"shield": {"time": 0}}], "guards.shield.time must be above 0, got 0"),
        (["all", {"map": {"sight": "far"}}], "guards.map.sight must be a number, got 'far'"),
        (["all", {"evasion": {"sight": 500}}], r"guards.evasion.sight must be in \(0, 100\], got 500"),
        (["all", {"shield": 3}], "guards.shield must hold settings such as guards.shield.time=0.7, got 3"),
        (["map", {"shield": {"lag": 0.1}}], r"shield is not among the guards asked for: add guards=\[map,shield\]"),
        ({"map": {"sight": 9}}, r"map is not among the guards of this policy: add guards=\[map,shield\]"),
    ],
)
def test_a_slip_is_told_in_a_sentence(asked: Any, told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        guard_settings(asked, GuardSettings(shield=ShieldSettings()))


@pytest.mark.parametrize(
    ("given", "joined"),
    [
        (["a=1", "guards=all", "b=2"], ["a=1", "guards=all", "b=2"]),
        (["guards=none", "guards=all"], ["guards=all"]),
        (["guards=all,none"], ["guards=all,none"]),
        (["guards.map.sight=9", "a=1", "guards=[map]"], ["guards=[map,{map: {sight: 9}}]", "a=1"]),
        (["guards=null", "+guards.map.sight=9"], ["guards=[{map: {sight: 9}}]"]),
        (["guards=[]", "guards.map.sight=9"], ["guards=[{map: {sight: 9}}]"]),
        (["policy=best"], ["policy=best"]),
    ],
)
def test_a_command_line_says_it_all_in_one_value(given: list[str], joined: list[str]) -> None:
    assert join_guards(given) == joined


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("guards.shield=1", "guards.shield is no setting of a guard: write guards.GUARD.SETTING=VALUE"),
        ("guards.shield.margin=", "guards.shield.margin is no setting of a guard"),
    ],
)
def test_a_command_line_that_means_guards_is_told_how_to_write_them(given: str, told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        join_guards(["policy=best", given])
