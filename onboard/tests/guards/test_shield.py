"""A shield lets through what is safe, and of the rest what is left when the way to the obstacle is taken out of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.guards.shield import Shield, keep_within
from uavrl_onboard.vehicle import DECELERATION, Vehicle

LEVEL = (0.0, 0.0)
STILL = np.zeros(3)
FAST = np.array([2.0, 0.0, 0.0])


def at_hulls_height(*places: tuple[float, float]) -> np.ndarray:
    """Points as the LiDAR sees them, which sits 0.1 m over the hull's middle."""
    return np.array([[x, y, -0.1] for x, y in places])


@pytest.mark.parametrize(
    ("gap", "speed"), [(2.0, 2.0), (1.52, 2.0), (0.82, 1.0), (0.47, 0.5), (0.12, 0.0), (0.05, 0.0)]
)
def test_the_gap_less_the_margin_is_closed_in_seven_tenths_of_a_second_at_the_earliest(
    gap: float, speed: float
) -> None:
    found = Shield()(FAST, at_hulls_height((0.35 + gap, 0.0)), LEVEL, STILL)
    assert found == pytest.approx([speed, 0.0, 0.0], abs=1e-6)


def test_what_is_safe_is_flown_as_it_is_asked_for() -> None:
    asked = np.array([-2.0, 0.3, 1.0])
    for cloud in (np.full((4, 3), np.nan), np.zeros((3, 3)), np.zeros((0, 3)), np.full((1, 3), np.inf)):
        assert Shield()(asked, cloud, LEVEL, STILL).tolist() == asked.tolist()
    assert Shield()(asked, at_hulls_height((0.5, 0.0)), LEVEL, STILL).tolist() == asked.tolist()  # away from it


def test_a_vehicle_that_flies_on_for_a_moment_has_less_of_the_gap() -> None:
    ahead = at_hulls_height((0.35 + 1.42, 0.0))
    assert Shield()(FAST, ahead, LEVEL, np.array([1.0, 0.0, 0.0])) == pytest.approx([1.0 / 0.7, 0.0, 0.0], abs=1e-6)
    assert Shield()(FAST, ahead, LEVEL, np.array([-1.0, 0.0, 0.0])) == pytest.approx([1.3 / 0.7, 0.0, 0.0], abs=1e-6)


def test_along_a_wall_it_flies_on() -> None:
    wall = at_hulls_height(*((x, 1.0) for x in np.linspace(-2, 2, 41)))
    forward, left, up = Shield()(np.array([1.5, 1.5, 0.0]), wall, LEVEL, STILL)
    assert forward > 0.9 and 0.0 < left < 0.8 and up == pytest.approx(0.0, abs=1e-6)


def test_in_a_corner_it_stands() -> None:
    ends = np.linspace(-0.4, 0.4, 9)
    corner = at_hulls_height(*((0.47, y) for y in ends), *((x, 0.47) for x in ends))
    assert np.abs(Shield()(np.array([2.0, 2.0, 0.0]), corner, LEVEL, STILL)).max() < 0.15


def test_the_hull_is_flat() -> None:
    above, up = np.array([[0.0, 0.0, 0.51]]), np.array([0.0, 0.0, 2.0])  # 0.61 over the middle, 0.47 over the hull
    assert Shield()(up, above, LEVEL, STILL)[2] == pytest.approx((0.61 - 0.26) / 0.7)


def test_a_tilted_sensor_sees_what_is_level() -> None:
    """At a pitch of 0.3 rad nose down, what is straight ahead stands above the sensor's own horizon."""
    pitch, roll = 0.3, 0.2
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    body_to_level = about_y @ about_x
    seen = (body_to_level.T @ np.array([0.82 + 0.35, 0.0, 0.0]) - [0.0, 0.0, 0.1])[None]
    assert Shield()(FAST, seen, (roll, pitch), STILL) == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_whatever_stands_around_nothing_is_approached_too_fast() -> None:
    rng, shield = np.random.default_rng(0), Shield()
    for _ in range(200):
        cloud, asked = rng.normal(0, 1.2, (rng.integers(1, 200), 3)), rng.uniform(-2, 2, 3)
        towards, speed = shield.bounds(cloud, LEVEL, STILL)
        (found,) = keep_within(asked[None], towards, speed[None])
        assert (towards @ found - speed).max(initial=0.0) <= 0.1 + 1e-9
        assert np.linalg.norm(found) <= np.linalg.norm(asked) + 1e-9


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"time": 0.0}, "time must be a finite number above 0, got 0.0"),
        ({"lag": float("nan")}, "lag must be a finite number of 0 or more, got nan"),
        ({"margin": -0.1}, "margin must be a finite number of 0 or more, got -0.1"),
        (
            {"vehicle": Vehicle(height=0.5)},
            "rim of a hull of radius 0.35 m and height 0.5 m sticks out .* margin of 0.12 m: raise margin",
        ),
    ],
)
def test_a_shield_that_bounds_nothing_is_refused(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(UavrlError, match=told):
        Shield(**wrong)


@pytest.mark.parametrize("place", range(4))
def test_numbers_that_are_none_are_refused(place: int) -> None:
    asked, cloud, tilt, velocity = FAST, at_hulls_height((1.0, 0.0)), LEVEL, STILL
    told = [asked, cloud, tilt, velocity]
    told[place] = [np.full(3, np.nan), np.zeros((3, 2)), (np.nan, 0.0), np.array([np.inf, 0.0, 0.0])][place]
    with pytest.raises(UavrlError, match=r"finite numbers|cloud \[points, 3\], got \[3, 2\]"):
        Shield()(*told)  # type: ignore[arg-type]


def test_of_a_sensor_that_sees_nothing_near_more_distance_is_kept() -> None:
    """What is 0.9 m from the sensor is about to vanish: nothing may be flown towards it."""
    assert Shield(nearest=0.9)(FAST, at_hulls_height((0.9, 0.0)), LEVEL, STILL)[0] == pytest.approx(0.0, abs=1e-6)
    assert Shield(nearest=0.3)(FAST, at_hulls_height((0.9, 0.0)), LEVEL, STILL)[0] > 0.5


def test_a_velocity_beyond_the_limit_keeps_its_direction() -> None:
    oblique = at_hulls_height(*((0.8 + 0.5 * y, y) for y in np.linspace(-1, 1, 21)))
    asked = np.array([2.0, -2.0, 0.0])
    free, limited = (
        Shield(vehicle=Vehicle(velocity_limit=most))(asked, oblique, LEVEL, STILL) for most in (100.0, 0.2)
    )
    assert np.abs(limited).max() == pytest.approx(0.2)
    assert limited / np.linalg.norm(limited) == pytest.approx(free / np.linalg.norm(free))


def test_the_vehicles_own_parts_are_no_obstacle() -> None:
    rotors = np.array([[0.2, 0.2, -0.1], [0.2, -0.2, -0.1], [-0.2, 0.2, -0.1], [-0.2, -0.2, -0.1]])
    assert Shield()(FAST, rotors, LEVEL, STILL).tolist() == FAST.tolist()


@pytest.mark.parametrize("limit", [4.0, 6.0])
def test_a_fast_vehicle_brakes_before_a_wall_as_hard_as_it_can_tilt(limit: float) -> None:
    shield = Shield(vehicle=Vehicle(velocity_limit=limit))
    y, z = (part.ravel() for part in np.meshgrid(np.linspace(-3, 3, 61), np.linspace(-1, 1, 21)))
    place, velocity, step = 0.0, limit, 0.02
    for _ in range(500):
        wall = np.stack([np.full_like(y, 12.0 - place), y, z], -1)
        asked = shield(np.array([limit, 0.0, 0.0]), wall, (0.0, 0.0), np.array([velocity, 0.0, 0.0]))[0]
        velocity += min(max(asked - velocity, -DECELERATION * step), DECELERATION * step)
        place += step * velocity
    assert 10.5 < place < 12.0 - shield.vehicle.radius
    assert velocity == pytest.approx(0.0, abs=0.05)
    held = Shield(vehicle=Vehicle(velocity_limit=2.0))
    assert held(np.array([2.0, 0.0, 0.0]), np.array([[3.0, 0, 0]]), (0.0, 0.0), np.zeros(3))[0] == 2.0
