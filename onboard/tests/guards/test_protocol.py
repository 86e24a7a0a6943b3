"""All guards together: what moves is left to evasion, and what one guard changes the next one sees."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.chain import GUARDS, Guards
from uavrl_onboard.guards.map import Wayfinder
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import (
    EvasionSettings,
    GuardSettings,
    MapSettings,
    ShieldSettings,
    guard_settings,
)
from uavrl_onboard.vehicle import Vehicle

LEVEL, PERIOD = 3.5, 0.1
ASKED = np.array([[2.0, 0.0, 0.0]])


def plane(place: np.ndarray) -> np.ndarray:
    """Points ``[P, 3]`` on a flat body of 1.2 m by 0.4 m, which faces the sensor."""
    y, z = (each.ravel() for each in np.meshgrid(np.arange(-0.6, 0.61, 0.1), np.arange(-0.2, 0.21, 0.05)))
    return place + np.stack([np.zeros(len(y)), y, z], -1)


def wall(distance: float, half: float = 5.0) -> np.ndarray:
    """Points of a wall across the way."""
    y, z = (each.ravel() for each in np.meshgrid(np.arange(-half, half, 0.1), np.arange(-0.8, 0.81, 0.2)))
    return np.stack([np.full(len(y), distance), y, z], -1)


def situation(points: np.ndarray, **more: Any) -> Situation:
    """A vehicle that stands at its flight level, with the goal straight ahead."""
    still = np.zeros((1, 3)), np.zeros((1, 3)), np.full(1, LEVEL), np.zeros(1)
    return Situation(points[None].astype(np.float32), *still, **more)


def crossing(step: int, x: float = 5.0) -> np.ndarray:
    """A plane that crosses from the right to the left at 3 m/s."""
    return plane(np.array([x, -4.0 + 3.0 * PERIOD * step, 0.0]))


def known(guards: Guards) -> np.ndarray:
    """The middles of the cells in the map of the only vehicle."""
    led = guards.guards["map"]
    assert isinstance(led, Wayfinder)
    return led.navigators[0].known.middles()


def test_a_plane_that_crosses_stays_in_a_map_alone_and_not_beside_evasion() -> None:
    alone, together = Guards(GuardSettings(map=MapSettings())), Guards(GuardSettings.all())
    for step in range(30):
        scan = np.concatenate([crossing(step), wall(8.0)])
        for guards in (alone, together):
            guards.lead(situation(scan))
    ghosts, left = (middles[np.abs(middles[:, 0] - 5.0) < 0.5] for middles in (known(alone), known(together)))
    assert len(ghosts) > 10, "a map that nobody tells what moves keeps the whole path"
    assert not len(left), "cells from before the plane was known to move are forgotten, too"
    standing = [(middles[:, 0] > 7.5).sum() for middles in (known(alone), known(together))]
    assert standing[0] == standing[1] > 30, "the wall stays"


def test_a_post_beside_the_path_of_a_plane_stays_in_the_map() -> None:
    post = plane(np.array([4.0, 1.0, 0.0])) * [1.0, 0.1, 1.0] + [0.0, 0.9, 0.0]
    guards = Guards(GuardSettings.all())
    for step in range(30):
        guards.lead(situation(np.concatenate([crossing(step), post])))
    assert len(known(guards)) and np.abs(known(guards)[:, 0] - 4.0).max() < 0.5


def passing(settings: GuardSettings) -> list[np.ndarray]:
    """What is flown while a plane flies past, ahead and across, 1.4 m from the hull, on its way out of the way."""
    guards, flown = Guards(settings), list[np.ndarray]()
    for step in range(24):
        guards.lead(situation(crossing(step, x=1.7)))
        flown.append(guards.filter(ASKED)[0])
    return flown


def test_the_shield_leaves_to_evasion_what_moves_and_bounds_what_stands() -> None:
    """When the plane is no threat any more, evasion lets the vehicle go on, where the shield alone would slow it."""
    together, shield = passing(GuardSettings.all()), passing(GuardSettings(shield=ShieldSettings()))
    evasion = passing(GuardSettings(evasion=EvasionSettings()))
    moving = [step for step in range(10, 24) if not np.allclose(shield[step], ASKED[0])]
    assert moving, "the plane is near enough for the shield"
    assert all(np.allclose(together[step], evasion[step]) for step in moving)
    assert any(not np.allclose(together[step], shield[step]) for step in moving)


def test_the_shield_has_the_last_word() -> None:
    """A plane comes ahead; whatever evasion chooses, the walls on both sides are not approached too fast."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-2.0, 6.0, 0.1), np.arange(-0.5, 0.6, 0.1)))
    walls = np.concatenate([np.stack([x, np.full(len(x), side), z], -1) for side in (-0.62, 0.62)])
    guards, evasion = Guards(GuardSettings.all()), Guards(GuardSettings(evasion=EvasionSettings()))
    bent = 0.0
    for step in range(12):
        scan = situation(np.concatenate([plane(np.array([7.0 - 0.3 * step, 0.0, 0.0])), walls]))
        for each in (guards, evasion):
            each.lead(scan)
        flown, asked = guards.filter(ASKED)[0], evasion.filter(ASKED)[0]
        assert abs(flown[1]) <= (0.62 - 0.35 - 0.12) / 0.7 + 0.11
        bent = max(bent, float(np.abs(flown - asked).max()))
    assert bent > 0.05, "evasion asked for more than the shield allows"


def test_a_wall_beside_a_plane_still_slows_the_vehicle() -> None:
    """A plane flies along a wall, 0.4 m in front of it, and is left out; the wall is not."""
    chosen = Guards(GuardSettings(evasion=EvasionSettings(), shield=ShieldSettings()))
    alone = Guards(GuardSettings(shield=ShieldSettings()))
    for step in range(16):
        seen = situation(np.concatenate([crossing(step, x=1.2), wall(1.6)]))
        chosen.lead(seen)
    alone.lead(situation(wall(1.6)))
    moving = seen.moving[0]
    assert moving is not None and moving[: len(crossing(0))].mean() > 0.5, "the plane's points"
    assert moving[len(crossing(0)) :].mean() < 0.1, "and hardly any of the wall's"
    assert chosen.guards["shield"].filter(ASKED, seen)[0, 0] <= alone.filter(ASKED)[0, 0] + 0.15 < 1.8


def test_what_stands_is_the_scan_without_what_moves_and_without_misses() -> None:
    cloud = np.array([[1.0, 0, 0], [np.nan] * 3, [2.0, 0, 0], [0.0] * 3, [3.0, 0, 0], [9.0, 0, 0]])
    seen = situation(cloud)
    assert seen.standing(0, 4.0)[:, 0].tolist() == [1.0, 2.0, 3.0]
    seen.moving[0] = np.array([False, True, False, False])
    assert seen.standing(0, 4.0)[:, 0].tolist() == [1.0, 3.0]
    assert seen.standing(0, np.inf)[:, 0].tolist() == [1.0, 3.0, 9.0]


def test_a_vehicle_without_a_new_scan_keeps_what_it_saw() -> None:
    guards = Guards(GuardSettings.all(), vehicles=2)

    def both(step: int, **more: Any) -> Situation:
        cloud = np.stack([crossing(step)] * 2).astype(np.float32)
        return Situation(cloud, np.zeros((2, 3)), np.zeros((2, 3)), np.full(2, LEVEL), np.zeros(2), **more)

    for step in range(12):
        guards.lead(both(step))
    first = guards._seen
    assert first is not None and len(first.bodies[0]) == len(first.bodies[1]) == 1
    guards.reset(np.array([True, False]))
    again = both(11, which=np.array([True, False]))
    guards.lead(again)
    assert not len(again.bodies[0]) and again.moving[0] is None
    assert again.bodies[1] is first.bodies[1] and again.moving[1] is first.moving[1]
    assert (again.objects[1] == first.objects[1]).all() and not again.objects[0].any()


def test_another_vehicles_new_episode_does_not_blind_a_vehicle() -> None:
    """An environment that begins one vehicle's episode gives the others no scan: they have had theirs."""
    for names in ("all", ["shield"]):
        guards = Guards(guard_settings(names), vehicles=2)
        near = np.stack([wall(1.2)] * 2).astype(np.float32)
        still = np.zeros((2, 3)), np.zeros((2, 3)), np.full(2, LEVEL), np.zeros(2)
        guards.lead(Situation(near, *still))
        before = guards.filter(np.tile(ASKED, (2, 1)))
        assert before[1, 0] < 1.5, "the wall is near"
        guards.reset(np.array([True, False]))
        near[1] = np.nan
        guards.lead(Situation(near, *still, which=np.array([True, False])))
        np.testing.assert_array_equal(guards.filter(np.tile(ASKED, (2, 1))), before)


def test_a_known_place_leads_as_a_place_that_is_found_out_does() -> None:
    ahead = wall(3.0, half=2.0) + np.array([0.0, 1.5, 0.0])
    guesses, knows = (Guards(GuardSettings(map=MapSettings())) for _ in range(2))
    turn = guesses.lead(situation(ahead))[0]
    place = {"places": np.array([[7.0, -2.0, LEVEL]]), "goals": np.array([[22.0, -2.0]])}
    assert knows.lead(situation(ahead, **place))[0] == pytest.approx(turn, abs=0.15)
    assert -1.5 < turn < -0.2, "to the right, around the near end"


def test_kept_maps_survive_a_reset_of_the_others() -> None:
    guards = Guards(GuardSettings.all())
    guards.lead(situation(wall(3.0)))
    guards.reset(keep_map=True)
    assert len(known(guards))
    guards.reset()
    assert not len(known(guards))


@pytest.mark.parametrize("part", ["velocities", "attitudes", "altitudes"])
@pytest.mark.parametrize("names", [["evasion"], ["shield"], ["all"]])
def test_without_the_vehicles_state_nothing_passes(part: str, names: list[str]) -> None:
    seen = situation(wall(3.0))
    setattr(seen, part, getattr(seen, part) + np.nan)
    with pytest.raises(UavrlError, match=r"Guards \((evasion|shield|evasion and shield)\) need finite numbers, got"):
        Guards(guard_settings(names)).lead(seen)


def test_velocities_are_filtered_only_after_a_scan() -> None:
    with pytest.raises(UavrlError, match="Guards filter velocities only after a scan: call lead first"):
        Guards(GuardSettings.all()).filter(ASKED)


def test_the_order_of_the_guards_stands_in_their_settings() -> None:
    names = [field.name for field in fields(GuardSettings)]
    assert list(GUARDS) == names == list(Guards(guard_settings(["shield", "evasion", "map"])).guards)


def test_guards_know_the_vehicle() -> None:
    """A hull that is 0.2 m wider has 0.2 m less to the wall."""
    flown = []
    for radius in (0.35, 0.55):
        guards = Guards(GuardSettings(shield=ShieldSettings(time=1.0)), vehicle=Vehicle(radius=radius, height=0.28))
        guards.lead(situation(np.array([[1.2, 0.0, -0.1]])))
        flown.append(guards.filter(ASKED)[0, 0])
    assert flown[0] - flown[1] == pytest.approx(0.2, abs=1e-5)


def test_motion_is_looked_for_where_the_lidar_looks() -> None:
    """A plane crosses 30 degrees above the vehicle, where a VLP-16 sees nothing and a Mid-360 does."""
    for elevations, found in (((-15.0, 15.0), False), ((-7.0, 52.0), True)):
        guards = Guards(GuardSettings(evasion=EvasionSettings()), 1, Vehicle(lidar_elevations=elevations))
        for step in range(12):
            place = crossing(step) + np.array([0.0, 0.0, 3.0])
            guards.lead(seen := situation(place))
        assert bool(seen.objects.any()) == found


def test_a_copy_of_a_situation_with_another_scan_has_the_returns_of_that_scan() -> None:
    far, still = wall(40.0)[None], np.zeros((1, 3))
    seen = Situation(far, still, still, np.full(1, LEVEL), np.zeros(1))
    guards = Guards(GuardSettings(shield=ShieldSettings()))
    guards.lead(seen)
    assert guards.filter(ASKED)[0, 0] == pytest.approx(2.0)
    guards.lead(replace(seen, clouds=wall(0.8)[None]))
    assert guards.filter(ASKED)[0, 0] < 1.0


NEW_MODULES = """
import sys
import numpy as np
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import GuardSettings
guards, ring = Guards(GuardSettings.all()), np.linspace(-0.15, 0.15, 5)
ball = np.stack(np.broadcast_arrays(8.0, ring[:, None], ring), -1).reshape(1, -1, 3)
wall = np.stack(np.broadcast_arrays(10.0, np.linspace(-9.0, 9.0, 400)[:, None], ring), -1).reshape(1, -1, 3)
for step in range(10):
    points = np.concatenate([ball - [0.3 * step, 0.0, 0.0], wall], 1)
    seen = Situation(points, np.zeros((1, 3)), np.zeros((1, 3)), np.full(1, 3.5), np.zeros(1))
    guards.lead(seen)
    guards.filter(np.array([[2.0, 0.0, 0.0]]))
    if step == 0:
        before = set(sys.modules)
print(seen.moving[0] is not None, sorted(set(sys.modules) - before))
"""


def test_no_library_loads_in_the_cycle_in_which_the_first_body_moves() -> None:
    ran = subprocess.run([sys.executable, "-c", NEW_MODULES], check=True, capture_output=True, text=True)
    assert ran.stdout.split(maxsplit=1) == ["True", "[]\n"]
