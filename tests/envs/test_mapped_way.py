"""The quickest ways through what vehicles have scanned, which the environment emits for demonstrators and critics."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from uavrl.envs import NavigationEnv
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.mapped_way import MappedWays
from uavrl.envs.world import WorldConfig
from uavrl.policies.baselines import StraightPolicy
from uavrl.transforms import Guarded, NavigationState
from uavrl_onboard.guards.map.wayfinder import Wayfinder
from uavrl_onboard.vehicle import VEHICLE

TRAPPED = WorldConfig(seeds=(200,), traps=3, obstacles=20)
NOTHING = np.full((1, 3), np.nan, np.float32)


def dead_end(depth: float = 2.5) -> np.ndarray:
    """Points of three walls around the sensor, open behind it: ``[P, 3]`` m."""
    along, across = np.linspace(-2.5, depth, 80), np.linspace(-1.5, 1.5, 60)
    walls = [np.stack(np.broadcast_arrays(along, side, -0.1), -1) for side in (-1.5, 1.5)]
    walls.append(np.stack(np.broadcast_arrays(depth, across, -0.1), -1))
    return np.concatenate(walls).astype(np.float32)


def hovering(*clouds: np.ndarray, heading_deg: float = 0.0) -> dict[str, np.ndarray]:
    """What vehicles emit that hover at the flight level, with their scans padded to as many points."""
    n, most = len(clouds), max(map(len, clouds))
    points = np.full((n, most, 3), np.nan, np.float32)
    for row, cloud in zip(points, clouds, strict=True):
        row[: len(cloud)] = cloud
    still, level = np.zeros((n, 3)), np.full(n, VEHICLE.flight_level)
    told = {"point_cloud": points, "velocity": still, "attitude": still}
    return told | {"altitude": level, "heading_deg": np.full(n, heading_deg)}


BOTH = np.ones(2, bool)


def test_it_leads_out_of_a_dead_end_that_the_heading_points_into() -> None:
    ways = MappedWays(2, VEHICLE, reach=4.0)
    into, free = ways.directions(hovering(dead_end(), NOTHING), BOTH)
    assert into[0] < -0.5, "out of it, backwards"
    np.testing.assert_allclose(free, [1.0, 0.0], atol=1e-9, err_msg="straight to the goal")
    np.testing.assert_allclose(np.linalg.norm(into), 1.0)


def test_the_way_is_relative_to_the_vehicles_head() -> None:
    ways = MappedWays(1, VEHICLE, reach=4.0)
    np.testing.assert_allclose(ways.directions(hovering(NOTHING, heading_deg=90.0), BOTH[:1]), [[0.0, 1.0]], atol=1e-9)


def test_a_new_episode_begins_with_an_empty_map_and_the_others_keep_theirs() -> None:
    ways = MappedWays(2, VEHICLE, reach=4.0)
    before = ways.directions(hovering(dead_end(), dead_end()), BOTH).copy()
    ways.begin(np.array([True, False]))
    first, other = ways.directions(hovering(NOTHING, NOTHING), BOTH)
    np.testing.assert_allclose(first, [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(other, before[1], atol=1e-9)


def test_a_vehicle_without_a_new_scan_keeps_its_way() -> None:
    ways = MappedWays(2, VEHICLE, reach=4.0)
    before = ways.directions(hovering(dead_end(), NOTHING), np.array([True, False])).copy()
    after = ways.directions(hovering(NOTHING, dead_end()), np.array([False, True]))
    np.testing.assert_array_equal(after[0], before[0])
    assert after[1, 0] < -0.5


@pytest.mark.parametrize(("reach", "seen"), [(4.0, False), (12.0, True), (100.0, True)])
def test_it_sees_as_far_as_the_lidar_reports(reach: float, seen: bool) -> None:
    side = np.linspace(-9.0, 6.0, 200)
    wall = np.stack(np.broadcast_arrays(7.0, side, -0.1), -1).astype(np.float32)
    ((_, left),) = MappedWays(1, VEHICLE, reach).directions(hovering(wall), BOTH[:1])
    assert (left > 0.05) == seen, "past the wall's near end"


def flown(*privileged: str, guarded: bool = False) -> TensorDictBase:
    """What vehicles emit that fly straight at their goals in a valley with dead ends."""
    base = NavigationEnv(3, world=TRAPPED, lidar=LidarConfig(max_range=4.0), privileged=privileged, max_steps=30)
    guards = [Guarded(["map", {"map": {"sight": 4.0}}] if guarded else "none")]
    env = TransformedEnv(base, Compose(*guards, NavigationState(reduction="range_image", last_action=True)))
    found = env.rollout(40, StraightPolicy(), break_when_any_done=False)
    env.close()
    return found


def angle(unit: torch.Tensor) -> torch.Tensor:
    return torch.rad2deg(torch.atan2(unit[..., 1:], unit[..., :1])).remainder(360)


def test_what_else_is_emitted_stays_bit_by_bit() -> None:
    plain, more = flown(), flown("mapped_way")
    assert set(more.keys(True, True)) - set(plain.keys(True, True)) == {"mapped_way", ("next", "mapped_way")}
    for key in plain.keys(True, True):
        assert torch.equal(plain[key], more[key]), key
    assert plain["next", "done"].any(1).all(), "episodes began meanwhile"


def test_it_is_the_heading_that_the_guard_turns_or_that_to_the_goal() -> None:
    """One by what the environment emits in single precision, the other by its own numbers."""
    found = flown("mapped_way", guarded=True)
    led, goal = found["heading_deg"], found["goal_heading_deg"]
    off, beside, turned = (
        ((one - other + 180).remainder(360) - 180).abs()
        for one, other in ((angle(found["mapped_way"]), led), (angle(found["mapped_way"]), goal), (led, goal))
    )
    nearest = torch.minimum(off, beside)
    assert nearest.median() < 1e-3 and (nearest < 1.0).float().mean() > 0.95
    assert ((turned > 5) & (off < 1.0)).float().mean() > 0.02, "the map turns it where a dead end is ahead"
    assert ((turned > 5) & (beside < 1.0)).float().mean() > 0.02, "but not for single obstacles"


def test_the_blind_are_led_straight_to_the_goal() -> None:
    env = NavigationEnv(2, world=TRAPPED, privileged=["mapped_way"], blind=True)
    found = env.rollout(3, break_when_any_done=False)["next"]
    torch.testing.assert_close(angle(found["mapped_way"]), found["heading_deg"], atol=1e-3, rtol=0)
    env.close()


def test_small_detours_are_left_to_the_vehicle_and_a_way_out_is_followed_to_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ways = MappedWays(1, VEHICLE, reach=4.0)
    turns, detours = iter((0.5, 0.5, 0.5, 0.5, 0.5)), iter((2.0, 4.0, 1.0, 0.4, 2.0))
    monkeypatch.setattr(Wayfinder, "lead", lambda self, seen: np.array([next(turns)]))
    monkeypatch.setattr(Wayfinder, "detours", property(lambda self: np.array([next(detours)])))
    followed = [bool(ways.directions(hovering(NOTHING), BOTH[:1])[0, 1] > 0.1) for _ in range(5)]
    assert followed == [False, True, True, False, False]


def test_a_new_episode_follows_no_way_until_it_is_long_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ways, detours = MappedWays(1, VEHICLE, reach=4.0), iter((4.0, 1.0))
    monkeypatch.setattr(Wayfinder, "lead", lambda self, seen: np.array([0.5]))
    monkeypatch.setattr(Wayfinder, "detours", property(lambda self: np.array([next(detours)])))
    assert ways.directions(hovering(NOTHING), BOTH[:1])[0, 1] > 0.1
    ways.begin(BOTH[:1])
    assert ways.directions(hovering(NOTHING), BOTH[:1])[0, 1] == 0.0


def test_a_post_ahead_does_not_turn_the_heading() -> None:
    post = np.array([[2.0, 0.1, -0.1], [2.0, 0.2, -0.1]], np.float32)
    ahead = MappedWays(1, VEHICLE, reach=4.0).directions(hovering(post), BOTH[:1])
    np.testing.assert_allclose(ahead, [[1.0, 0.0]], atol=1e-9)
