"""Scans that do not move as the pose says: each is fresh, finite and full of returns."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from onboard.tests.flight.test_loop import Rig

from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.flight.safety import Reason, SafetyState
from uavrl_onboard.flight.scan_motion import ScanMotion

AZIMUTHS = np.radians(np.arange(0.25, 360.0, 0.5))
HEIGHTS = (-0.6, -0.3, 0.0, 0.3)  # m, of the returns from a trunk
SIDES = np.array([1.0, -1.0, 1.0])


def trunks(seed: int = 0, count: int = 40) -> np.ndarray:
    """x, y and radius of trunks, m, none within 1.5 m of the way along x."""
    rng = np.random.default_rng(seed)
    found = np.c_[rng.uniform(-12, 25, count), rng.uniform(-10, 10, count), rng.uniform(0.2, 0.5, count)]
    return found[np.abs(found[:, 1]) > 1.5]


def scan(trunks: np.ndarray, place: np.ndarray, yaw: float, rng: np.random.Generator | None = None) -> np.ndarray:
    """What a level sensor sees of trunks and of flat ground 3 m below it, with noise of 3 cm."""
    rng = np.random.default_rng(0) if rng is None else rng
    to = trunks[:, :2] - place[:2]
    along = np.stack([np.cos(AZIMUTHS + yaw), np.sin(AZIMUTHS + yaw)], -1)
    middle, across = along @ to.T, along @ np.stack([-to[:, 1], to[:, 0]])
    inside = trunks[:, 2] ** 2 - across**2
    ranges = np.where((inside > 0) & (middle > 0), middle - np.sqrt(np.maximum(inside, 0)), np.inf)
    ranges = ranges.min(1, initial=np.inf)
    ranges = ranges + rng.normal(0.0, 0.03, ranges.shape)
    flat = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], -1)
    seen = np.isfinite(ranges) & (ranges < 30.0)
    walls = [np.c_[flat[seen] * ranges[seen, None], np.full(seen.sum(), height)] for height in HEIGHTS]
    ground = [np.c_[far * flat, np.full(len(flat), -3.0)] for far in (6.0, 9.0)]
    return np.concatenate([*walls, *ground])


def weaving(time: float) -> Pose:
    """A flight along x at 1.5 m/s that swings by a metre to either side, with its nose ahead."""
    side, rate = math.sin(0.8 * time), 0.8 * math.cos(0.8 * time)
    return Pose(time, (1.5 * time, side, 3.0), (1.5, rate, 0.0), math.atan2(rate, 1.5))


Seen = Callable[[np.ndarray, float], np.ndarray]
Told = Callable[[Pose], Pose]


def flown(
    seen: Seen = lambda points, time: points,
    told: Told = lambda pose: pose,
    way: Callable[[float], Pose] = weaving,
    world: np.ndarray | None = None,
    seconds: float = 8.0,
) -> list[str | None]:
    """What the check says of each scan of a flight."""
    check, rng, world = ScanMotion(), np.random.default_rng(1), trunks() if world is None else world
    found = []
    for number in range(int(10 * seconds)):
        pose = way(0.1 * number)
        points = seen(scan(world, np.array(pose.position), pose.yaw, rng), pose.stamp)
        found.append(check.add(points, told(pose)))
    return found


def turned(angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


class Repeats:
    """The first scan after a moment, again and again, or those of a while."""

    def __init__(self, after: float, scans: int = 1) -> None:
        self.after, self.scans, self.kept = after, scans, list[np.ndarray]()
        self.asked = 0

    def __call__(self, points: np.ndarray, time: float) -> np.ndarray:
        if time < self.after:
            return points
        if len(self.kept) < self.scans:
            self.kept.append(points)
        self.asked += 1
        return self.kept[(self.asked - 1) % len(self.kept)]


def stuck(pose: Pose) -> Pose:
    at = weaving(min(pose.stamp, 2.0))
    return Pose(pose.stamp, at.position, (0.0, 0.0, 0.0) if pose.stamp > 2.0 else at.velocity, at.yaw)


def elsewhere(position: Callable[[np.ndarray], np.ndarray], yaw: float = 0.0) -> Told:
    """An estimator whose position and velocity are turned alike, so that they agree with each other."""

    def tell(pose: Pose) -> Pose:
        place, velocity = (tuple(position(np.array(each)).tolist()) for each in (pose.position, pose.velocity))
        return Pose(pose.stamp, place, velocity, pose.yaw + yaw)  # type: ignore[arg-type]

    return tell


@pytest.mark.parametrize("seed", range(4))
def test_a_flight_by_a_true_pose_is_believed(seed: int) -> None:
    assert not any(flown(world=trunks(seed)))


@pytest.mark.parametrize(
    ("seen", "told", "says"),
    [
        (Repeats(2.0), None, "stood by its scans: does the LiDAR's driver repeat a scan, or is it a recording?"),
        (Repeats(0.0, 30), None, "look at how the LiDAR is mounted"),
        (lambda points, time: points * SIDES, None, "look at how the LiDAR is mounted, at its driver's axes"),
        (lambda points, time: points @ turned(math.pi / 2).T, None, "look at how the LiDAR is mounted"),
        (lambda points, time: points @ turned(math.pi).T, None, "look at how the LiDAR is mounted"),
        (lambda points, time: points * [1.0, -1.0, -1.0], None, "look at how the LiDAR is mounted"),
        (None, stuck, "the vehicle stood by its pose, and moved by"),
        (None, elsewhere(lambda each: each[[1, 0, 2]]), "by its pose, and moved by"),
        (None, elsewhere(lambda each: each, math.pi / 2), "and at the compass"),
        (None, elsewhere(lambda each: each * [3.28, 3.28, 1.0]), "by its pose, and moved by"),
        (None, lambda pose: Pose(pose.stamp, pose.position, pose.velocity, 0.8 * pose.stamp), "at the compass"),
    ],
    ids=[
        "a scan repeated",
        "a recording in a loop",
        "mirrored",
        "turned by 90°",
        "turned by 180°",
        "upside down",
        "the pose stands",
        "swapped axes",
        "yaw off by 90°",
        "another unit",
        "the yaw turns",
    ],
)
def test_scans_that_do_not_move_as_the_pose_says_are_told(seen: Seen | None, told: Told | None, says: str) -> None:
    kept = {"seen": seen} if seen is not None else {"told": told}
    found = flown(**kept)  # type: ignore[arg-type]
    assert found[-1] is not None and says in found[-1]


def test_the_sentence_tells_both_motions() -> None:
    ahead = flown(Repeats(1.0), way=lambda time: Pose(time, (2.0 * time, 0.0, 3.0), (2.0, 0.0, 0.0), 0.0))
    assert ahead[-1] == (
        "in 1.0 s the vehicle moved by 2.0 m towards 0° and turned by 0° by its pose, and stood by its scans: does the "
        "LiDAR's driver repeat a scan, or is it a recording?"
    )


def test_a_vehicle_that_stands_and_one_over_flat_ground_are_believed() -> None:
    assert not any(flown(way=lambda time: Pose(time, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 0.0)))
    assert not any(flown(world=np.zeros((0, 3)))), "rings on the ground move with the sensor"


def test_walls_along_which_nobody_sees_how_far_are_believed() -> None:
    def corridor(points: np.ndarray, time: float) -> np.ndarray:
        x = np.arange(-11.0, 11.0, 0.1)
        return np.concatenate([np.c_[x, np.full_like(x, side), np.zeros_like(x)] for side in (-2.0, 2.0)])

    assert not any(flown(corridor, way=lambda time: Pose(time, (2.0 * time, 0.0, 3.0), (2.0, 0.0, 0.0), 0.0)))


def test_a_part_of_the_scan_that_moves_along_is_believed() -> None:
    """A second vehicle that flies 3 m ahead all the time."""
    box = np.array([[3.0 + 0.1 * x, 0.1 * y, 0.0] for x in range(5) for y in range(-5, 5)])
    assert not any(flown(lambda points, time: np.concatenate([points, box])))


def test_it_is_over_once_scans_have_moved_as_the_pose_says() -> None:
    broken = Repeats(2.0)
    found = flown(lambda points, time: points if time > 5.0 else broken(points, time), seconds=10.0)
    assert found[48] is not None and found[-1] is None
    stands = flown(Repeats(2.0), way=lambda time: weaving(min(time, 4.0)), seconds=20.0)
    assert stands[-1] is not None, "what stands agrees with every pose that stands"


def test_a_pose_that_is_none_is_not_compared() -> None:
    check = ScanMotion()
    assert check.add(np.ones((50, 3)), None) is None
    assert check.add(np.ones((50, 3)), Pose(0.0, (math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)) is None


class Weaves(Rig):
    """A flight along `weaving` among trunks, whose sensor may be turned."""

    def seen(self, turn: np.ndarray) -> SafetyState:
        """One cycle; the state."""
        pose = weaving(self.now - 100.0)
        self.link.pose = lambda: Pose(self.now, *_rest(weaving(self.now - 100.0)))  # type: ignore[method-assign]
        return self.scan(scan(trunks(), np.array(pose.position), pose.yaw) @ turn.T).status.state


def _rest(pose: Pose) -> tuple[tuple[float, float, float], tuple[float, float, float], float]:
    return pose.position, pose.velocity, pose.yaw


def test_a_flight_by_a_turned_sensor_holds_and_then_sends_nothing() -> None:
    true, rig = Weaves(), Weaves()
    assert {true.seen(np.eye(3)) for _ in range(80)} == {SafetyState.SILENT, SafetyState.STANDBY, SafetyState.FLYING}
    states = [rig.seen(turned(math.pi / 2)) for _ in range(80)]
    assert SafetyState.HOLDING in states and states[-1] is SafetyState.SILENT
    last = rig.nothing().status
    assert last.reason is Reason.SCANS_DISAGREE and "look at how the LiDAR is mounted" in last.sentence


def test_a_dry_run_whose_vehicle_only_stands_is_not_compared() -> None:
    rig = Weaves(moves=False)
    assert [rig.seen(turned(math.pi / 2)) for _ in range(80)][-1] is SafetyState.FLYING
