"""Any velocity is kept out of the way of moving objects, and flown as it is asked for where there are none."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uavrl.transforms.numpy_boundary import call_numpy
from uavrl_onboard.geometry import body_to_level, body_to_world
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.evade import evaded, possible_ways
from uavrl_onboard.guards.evasion import Evasion
from uavrl_onboard.guards.protocol import Situation
from uavrl_onboard.guards.settings import EvasionSettings, GuardSettings
from uavrl_onboard.perception.motion.threats import HIGH, STEPS, WIDE, predict_path, straight_on
from uavrl_onboard.vehicle import Vehicle

ABOVE = 0.1  # m, of the LiDAR over the hull's middle
PERIOD = 0.1
LEVEL = 3.5
EVASION = GuardSettings(evasion=EvasionSettings())
AHEAD = np.array([[2.0, 0.0, 0.0]])


def ball(place: np.ndarray, radius: float = 0.3) -> np.ndarray:
    """Points ``[225, 3]`` on a ball, as close as a VLP-16's lasers are 6 m away."""
    across, up = np.meshgrid(np.linspace(0, 2 * np.pi, 15, endpoint=False), np.linspace(-1.4, 1.4, 15))
    shape = np.stack([np.cos(across) * np.cos(up), np.sin(across) * np.cos(up), np.sin(up)], -1)
    return place + radius * shape.reshape(-1, 3)


def flight(settings: GuardSettings, begin: list[float], speed: list[float]) -> tuple[float, np.ndarray]:
    """How near a ball comes that flies straight on, while the vehicle flies ahead, and all velocities ``[40, 3]``.

    1 keeps the margin, 0.66 touches.
    """
    guards, place, velocity, nearest, flown = Guards(settings), np.zeros(3), np.array([2.0, 0.0, 0.0]), np.inf, []
    for step in range(40):
        apart = np.array(begin) + PERIOD * step * np.array(speed) - place
        nearest = min(nearest, max(np.hypot(*apart[:2]) / WIDE, abs(apart[2]) / HIGH))
        cloud = (ball(apart) - [0.0, 0.0, ABOVE])[None]
        guards.lead(Situation(cloud, velocity[None], np.zeros((1, 3)), np.array([LEVEL + place[2]]), np.zeros(1)))
        flown.append(guards.filter(AHEAD)[0])
        velocity = velocity + 0.22 * (flown[-1] - velocity)
        place = place + PERIOD * velocity
    return float(nearest), np.array(flown)


@pytest.mark.parametrize(
    ("begin", "speed"),
    [([8.0, 0.2, 0.0], [-3.0, 0.0, 0.0]), ([4.0, 6.0, 0.0], [0.0, -3.0, 0.0]), ([4.0, -6.0, 0.2], [0.0, 3.0, 0.0])],
    ids=["ahead", "left", "right"],
)
def test_a_policy_that_knows_of_nothing_keeps_out_of_the_way_of_what_its_scans_show_to_move(
    begin: list[float], speed: list[float]
) -> None:
    assert flight(GuardSettings(), begin, speed)[0] < 0.6
    assert flight(EVASION, begin, speed)[0] > 0.9


def evasive(aside: float, standing: np.ndarray, tilt: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """What a vehicle that stands and may not leave its level flies instead of 2 m/s ahead: a ball comes, ``aside``."""
    vehicle = Vehicle(lowest=-0.01, highest=0.01)
    guards, attitude = Guards(EVASION, vehicle=vehicle), np.array([[*tilt, 0.0]])
    for step in range(14):
        points = np.concatenate([ball(np.array([8.0 - 0.3 * step, aside, 0.0])), standing])
        cloud = points @ body_to_world(attitude)[0] - [0.0, 0.0, ABOVE]
        guards.lead(Situation(cloud[None], np.zeros((1, 3)), attitude, np.full(1, LEVEL), np.zeros(1)))
        flown = guards.filter(AHEAD)[0]
    return flown


def wall(side: float) -> np.ndarray:
    """Points all along the vehicle, 0.9 m from its middle, to the left or to the right."""
    x, z = (each.ravel() for each in np.meshgrid(np.arange(-1.0, 4.0, 0.1), np.arange(-1.5, 1.6, 0.1)))
    return np.stack([x, np.full(len(x), 0.9 * side), z], -1)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.1)], ids=["level", "tilted"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_gives_way_to_the_side_on_which_its_scan_shows_nothing(side: float, tilt: tuple[float, float]) -> None:
    """The ball comes a little to the free side, to which it gives way for the wall alone."""
    free, beside = (evasive(-0.3 * side, each, tilt) for each in (wall(side)[:0], wall(side)))
    assert side * free[1] > 0.3, "away from the ball"
    assert side * beside[1] <= 0, "not into the wall"


def test_what_stands_is_reckoned_from_the_hulls_middle_in_level_axes_without_the_vehicles_own_parts() -> None:
    """Rolled by 90 degrees the LiDAR is 0.5 m to the right, and what it sees above it lies to the right, too."""
    rolled = body_to_level(np.array([[np.pi / 2, 0.0, 2.0]]))[0]
    rotor, above = [0.2, 0.2, -0.45], [1.0, 0.0, 1.5]
    still = np.zeros((1, 3))
    seen = Situation(np.array([[rotor, above]]), still, still, np.full(1, LEVEL), np.zeros(1))
    found = Evasion(vehicle=Vehicle(lidar_position=(0.0, 0.0, 0.5)))._around(seen, 0, rolled)
    assert found == pytest.approx(np.array([[1.0, -2.0, 0.0]]), abs=1e-6)


def hovering(guards: Guards, cloud: np.ndarray, asked: np.ndarray = AHEAD) -> np.ndarray:
    """What is flown by a vehicle that stands, after another scan."""
    guards.lead(Situation(cloud[None], np.zeros((1, 3)), np.zeros((1, 3)), np.full(1, LEVEL), np.zeros(1)))
    return guards.filter(asked)[0]


def test_what_passes_over_the_hull_is_let_pass_however_near_to_the_lidar() -> None:
    high = Guards(EVASION, vehicle=Vehicle(lidar_position=(0.0, 0.0, 0.5)))
    for step in range(14):
        above = ball(np.array([8.0 - 0.3 * step, 0.0, 0.4]), radius=0.1)  # 0.9 m over the hull's middle
        assert hovering(high, above).tolist() == AHEAD[0].tolist()


def test_what_stands_is_left_to_the_policy() -> None:
    assert (flight(EVASION, [6.0, 0.1, 0.0], [0.0, 0.0, 0.0])[1] == AHEAD).all()


def test_tensors_are_evaded_as_arrays_are() -> None:
    begins, speed = np.array([[4.0, 0.3, 0.0], [5.0, -4.0, 0.1], [9.0, 9.0, 0.0]]), np.array([-3.0, 1.0, 0.0])
    ways = begins[:, None, None] + PERIOD * np.arange(1, STEPS + 1)[:, None] * speed
    planned, known = np.array([[2.0, 0.0, 0.0]] * 3), np.ones((3, 1), bool)
    points, heights = [ball(np.array([1.5, 0.9, 0.0]))] * 3, np.array([[0.0], [0.6], [0.0]])
    arrays = evaded(planned, planned, ways, known, points, heights)
    told = [torch.from_numpy(each) for each in (planned, planned, ways, known)]
    found = call_numpy(evaded, *told, [torch.from_numpy(each) for each in points], torch.from_numpy(heights))
    assert found.tolist() == arrays.tolist()
    assert np.abs(arrays[0] - planned[0]).max() > 0.5 and (arrays[2] == planned[2]).all()


def test_what_is_asked_for_counts_as_far_as_it_may_be_flown() -> None:
    """At 2 m/s the vehicle would be past before the ball comes; at 1 m/s, which it may fly, both meet."""
    quick, slow = Guards(EVASION), Guards(EVASION, vehicle=Vehicle(velocity_limit=1.0))
    for step in range(10):
        aside = ball(np.array([0.4, 7.5 - 0.3 * step, 0.0]))
        free, bent = (hovering(guards, aside).tolist() for guards in (quick, slow))
    assert free == [2.0, 0.0, 0.0]
    assert bent not in ([2.0, 0.0, 0.0], [1.0, 0.0, 0.0])


def test_where_less_may_be_flown_it_evades_more_slowly() -> None:
    slow, most = Guards(EVASION, vehicle=Vehicle(velocity_limit=1.0)), 0.0
    for step in range(12):
        flown = hovering(slow, ball(np.array([9.0 - 0.3 * step, 0.5, 0.0])), np.array([[1.0, 0.0, 0.0]]))
        most = max(most, float(np.linalg.norm(flown[1:])))
        assert np.abs(flown).max() <= 1.0
    assert most > 0.4


def closest(flown: np.ndarray, velocity: np.ndarray, body: np.ndarray) -> float:
    """How near a body ``[7]`` comes that flies straight on, in units of the margin; below 0.66 it may touch."""
    ways, _ = straight_on(body[None])
    gap = predict_path(flown, velocity) - ways[0, 0]
    return float(np.maximum(np.hypot(gap[:, 0], gap[:, 1]) / WIDE, np.abs(gap[:, 2]) / HIGH).min())


@pytest.mark.parametrize(
    ("body", "velocity", "asked"),
    [
        ([-1.51, -1.29, 0.06, 3.28, 1.68, -0.1, 1.0], [1.89, 0.08, 0.24], [1.82, 0.08, 0.24]),
        ([1.34, -1.41, 0.05, -1.67, 3.12, -0.17, 1.0], [0.95, 0.68, -0.92], [1.99, 0.63, 0.33]),
        ([1.03, 1.9, -0.25, -1.3, -3.06, -0.03, 1.0], [1.72, -0.06, 0.11], [1.95, -0.15, -0.19]),
    ],
    ids=["from behind", "from the right", "from the left"],
)
def test_it_does_not_give_up_where_every_velocity_comes_too_near(
    body: list[float], velocity: list[float], asked: list[float]
) -> None:
    """Bodies that are less than a second away: none can be passed at the margin, but a collision can be avoided."""
    told, own, wanted = np.array(body), np.array(velocity), np.array(asked)
    ways, known = possible_ways(told[None, None])
    around = ([np.zeros((0, 3))], np.zeros((1, 1)))
    flown = evaded(wanted[None], own[None], ways, known, *around)[0]
    assert closest(wanted, own, told) < 0.5
    assert closest(flown, own, told) > 0.68


def test_what_dives_may_level_off() -> None:
    """A body dives from the right through the level of the vehicle; straight on, it would pass far below."""
    body = np.array([[[2.0, -2.6, 0.2, 0.0, 2.6, -2.6, 1.0]]])
    ahead = np.array([[2.0, 0.0, 0.0]])
    around = ([np.zeros((0, 3))], np.zeros((1, 1)))
    assert evaded(ahead, ahead, *straight_on(body.reshape(1, -1)), *around).tolist() == ahead.tolist()
    assert np.abs(evaded(ahead, ahead, *possible_ways(body), *around) - ahead).max() > 0.3
    level = body * [1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 1.0]
    assert possible_ways(level)[1].tolist() == [[True, False]]
