"""Each item of ``uavrl-check``: it fails, or warns, for the reason that the data have, and for no other."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from tests.helpers.exported import exported
from uavrl_onboard.autopilot.frames import Pose
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.flight.check import Evidence, Item, Level, Listener, Setup, everywhere
from uavrl_onboard.flight.check_items import judge
from uavrl_onboard.flight.health import FlightHealth
from uavrl_onboard.flight.limits import SafetyLimits
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.lidar.scans import Scan, Skipped
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.vehicle import VEHICLE

START, DAY = 100.0, 1_790_000_000.0  # s of the loop's clock, and of the day at its zero
RAYS = firing_directions().reshape(-1, 3)[::17].astype(np.float32)
ROOM = 6.0 * RAYS  # a round room
PX4 = VehicleStatus(Control.OTHER_MODE, "PX4 is in AUTO.LOITER, not in OFFBOARD", "PX4", "AUTO.LOITER", False)
SPEED = (0.01, 0.0, 0.0)
Points = Callable[[int], np.ndarray | None]


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return Policy(exported(tmp_path_factory.mktemp("exported"), "algo.hidden=[16,8]"))


class Feed:
    """A sensor that is heard, but sends no scans of itself: they come by number."""

    def __init__(self) -> None:
        self.skipped, self.told = Skipped(), list[str]()

    def trouble(self) -> str:
        return "look at the cable."

    def remarks(self) -> list[str]:
        return self.told


class Link:
    """A vehicle whose pose and status are given, and that keeps what it is sent."""

    def __init__(self) -> None:
        self.at: Pose | None = None
        self.who, self.sent = PX4, list[Any]()

    def receive(self, now: float) -> None: ...

    def pose(self) -> Pose | None:
        return self.at

    def status(self, now: float) -> VehicleStatus:
        return self.who

    def send(self, setpoint: Any, now: float) -> None:
        self.sent.append(setpoint)


class Come(NamedTuple):
    """What comes in a check."""

    scan: Points = lambda n: ROOM
    pose: Callable[[int, float], Pose | None] = lambda n, now: Pose(now - 0.01, (0.0, 0.0, 0.2), SPEED, 0.1, 0.01, 0.02)
    who: VehicleStatus = PX4
    scan_age: float = 0.005
    took: float = 0.003  # s of a cycle, which a busy machine would tell otherwise
    clock: Callable[[int], float] = lambda n: DAY
    goal: tuple[float, float, float] = (20.0, 0.0, 2.5)
    period: float = 0.1
    cycles: int = 60
    dry: bool = False


def items(policy: Policy, come: Come | None = None, feed: Feed | None = None, **setup: Any) -> dict[str, Item]:
    """The items of a check, by name; all that a healthy vehicle on the ground sends by default."""
    return {item.name: item for item in judge(evidence(policy, come or Come(), feed or Feed(), **setup))}


def evidence(policy: Policy, come: Come, feed: Feed, link: Any = None, guards: Any = None, **setup: Any) -> Evidence:
    played = Link()
    limits = setup.pop("limits", SafetyLimits())
    listener = Listener(played)  # type: ignore[arg-type]
    filters = Guards(guard_settings(guards))
    flight = Flight(policy, come.goal, listener, SafetyLayer(everywhere(limits)), guards=filters)
    vehicle = None if come.dry else link or played
    known = Setup(policy.contract, come.goal, limits, VEHICLE, feed, True, vehicle, **setup)  # type: ignore[arg-type]
    found = Evidence(known, flight, FlightHealth(feed.trouble, 10.0, stamped=True, remarks=feed.remarks))
    for number in range(come.cycles):
        now = START + number * come.period
        played.at, played.who, points = come.pose(number, now), come.who, come.scan(number)
        misses = 0 if points is None else int(np.isnan(points[:, 0]).sum())
        scan = None if points is None else Scan(now - come.scan_age, points, len(RAYS), misses, packets=8)
        cycle = replace(flight.step(now, scan), latency=None if scan is None else come.scan_age + come.took)
        found.add(cycle, listener.heard, come.clock(number))
    assert set(played.sent) == {None}, "nothing that could move a vehicle is sent"
    return found


def levels(told: dict[str, Item]) -> dict[str, str]:
    """The items that do not pass."""
    return {name: item.level.value for name, item in told.items() if item.level is not Level.PASS}


def test_a_healthy_vehicle_on_the_ground_passes(policy: Policy) -> None:
    told = items(policy)
    assert levels(told) == {}
    assert told["scans"].sentence.startswith("10.0 scans per second are read, and the policy acts 10 times.")
    assert told["scans"].sentence.endswith("They are 5 ms old (median); 200 ms are allowed.")
    assert told["field of view"].sentence == "Returns come from 8 of 8 directions, at -15° to 15°."
    assert told["returns"].sentence.startswith(
        "100 % of the rays return, 1,702 per scan (median); the nearest is 6.00 m"
    )
    assert told["position"].sentence.endswith("faces 6°, 0.8 m below the fence's floor, as before take-off.")
    assert told["pose age"].sentence == "Poses are 10 ms old (median), 10 ms (99 %); 100 ms are allowed."
    assert told["guards"].sentence == "The policy, without guards, gave an action to 60 of 60 scans."
    assert told["log"].sentence == "No log is written: log=null."
    assert told["clock"].sentence.endswith("says 2026-09-21 14:15 UTC.")


def test_no_scan(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: None))
    assert levels(told) == dict.fromkeys(("scans", "guards", "latency"), "fail")
    assert told["scans"].sentence == "No scan has come in 6 s: look at the cable."


def test_scans_that_cease(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: ROOM if n < 40 else None))
    assert levels(told) == {"scans": "fail"}
    assert "the scan is 2.00 s old (38 % of the time)" in told["scans"].sentence


def test_a_scan_that_is_late_once_is_a_warning(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: ROOM if n not in (30, 31) else None))
    assert levels(told) == {"scans": "warn"}


def test_a_slow_sensor(policy: Policy) -> None:
    told = items(policy, Come(period=0.19, cycles=40, pose=lambda n, now: Pose(now, (0.0, 0.0, 0.2), SPEED, 0.1, 0.01)))
    assert levels(told) == {"scans": "warn"}
    assert told["scans"].sentence.startswith("Scans come 5.3 times a second, and the policy has learned 10")


def test_stamps_of_the_first_point(policy: Policy) -> None:
    told = items(policy, Come(scan_age=0.12))
    assert levels(told) == {"clock": "warn"}
    assert "is header.stamp that of the first point?" in told["clock"].sentence


def test_a_second_sensor_and_another_model(policy: Policy) -> None:
    feed = Feed()
    feed.skipped.other_sender, feed.told = 300, ["Two senders: only 192.168.1.201:2368 is read."]
    told = items(policy, feed=feed)
    assert levels(told) == {"packets": "warn"}
    left_out = "Left out: 300 packets of a second sender."
    assert told["packets"].sentence == f"Two senders: only 192.168.1.201:2368 is read. {left_out}"
    found = evidence(policy, Come(), Feed())
    found.warnings.append(("uavrl_onboard.ros2.dds", "Two nodes publish on /points: only the first is read."))
    assert levels({item.name: item for item in judge(found)}) == {"packets": "warn"}
    feed = Feed()
    feed.skipped.lost, feed.skipped.position = 1, 9
    assert levels(items(policy, feed=feed)) == {}, "one of hundreds of packets"
    feed.skipped.lost = 30
    assert levels(items(policy, feed=feed)) == {"packets": "warn"}


def test_half_of_the_scan_is_cut_off(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: ROOM[ROOM[:, 0] > 0]))
    assert levels(told) == {"field of view": "fail"}
    assert "does the driver's window cut it off?" in told["field of view"].sentence


def test_a_gap_that_may_be_open_terrain(policy: Policy) -> None:
    degrees = np.degrees(np.arctan2(ROOM[:, 1], ROOM[:, 0])) % 360
    told = items(policy, Come(scan=lambda n: ROOM[(degrees < 100) | (degrees > 160)]))
    assert levels(told) == {"field of view": "warn"}
    assert "or does the driver's window" in told["field of view"].sentence


def test_scans_without_a_return(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: np.full_like(ROOM, np.nan)))
    assert levels(told) == {"field of view": "warn", "returns": "fail"}
    assert "scans in a row hold no return at all: is the sensor covered" in told["returns"].sentence


def test_scans_with_few_returns(policy: Policy) -> None:
    few = np.where(np.arange(len(ROOM))[:, None] % 80 == 0, ROOM, np.nan)
    told = items(policy, Come(scan=lambda n: few))
    assert levels(told) == {"field of view": "warn", "returns": "warn"}
    assert "1 % of the rays return, 22 per scan (median)" in told["returns"].sentence


def test_a_leg_in_the_scan(policy: Policy) -> None:
    leg = (
        np.tile(np.array([[-0.2, 0.1, -0.15]], np.float32), (40, 1))
        + np.linspace(0, 0.02, 40, dtype=np.float32)[:, None]
    )
    told = items(policy, Come(scan=lambda n: np.concatenate([ROOM, leg])))
    assert levels(told) == {"own body": "fail"}
    assert "holds 40 returns" in told["own body"].sentence
    assert "vehicle=[-0.25,0.05,-0.20,-0.13,0.17,-0.08]" in told["own body"].sentence


def test_something_at_the_hull(policy: Policy) -> None:
    mast = np.tile(np.array([[0.0, 0.5, -0.1]], np.float32), (40, 1))
    told = items(policy, Come(scan=lambda n: np.concatenate([ROOM, mast])))
    assert levels(told) == {"own body": "warn"}
    assert "0.15 m from the hull" in told["own body"].sentence
    passing = items(policy, Come(scan=lambda n: np.concatenate([ROOM, mast]) if n < 20 else ROOM))
    assert levels(passing) == {}, "somebody who has walked by"


@pytest.mark.parametrize(
    ("clock", "level", "says"),
    [(lambda n: -START + n, "fail", "says 1970-01-01"), (lambda n: DAY + 3.0 * (n > 30), "warn", "set by 3.0 s")],
)
def test_a_clock_that_is_not_set(policy: Policy, clock: Any, level: str, says: str) -> None:
    told = items(policy, Come(clock=clock))
    assert levels(told) == {"clock": level} and says in told["clock"].sentence


def test_a_clock_that_steps(policy: Policy) -> None:
    found = evidence(policy, Come(), Feed())
    found.warnings.append(
        ("uavrl_onboard.autopilot.clock_sync", "The clock that stamps /odom has stepped back by 3.0 s.")
    )
    told = {item.name: item for item in judge(found)}
    assert levels(told) == {"clock": "warn"} and "has stepped back by 3.0 s" in told["clock"].sentence


@pytest.mark.parametrize("control", [Control.WAITING, Control.UNSUPPORTED, Control.AMBIGUOUS, Control.LOST])
def test_a_vehicle_that_cannot_be_flown(policy: Policy, control: Control) -> None:
    told = items(policy, Come(who=VehicleStatus(control, "it says why")))
    assert levels(told) == {"autopilot": "fail"} and told["autopilot"].sentence == "It says why."
    assert "mode" not in told, "of a vehicle that is not heard there is none"


def test_a_mode_that_another_program_keeps(policy: Policy) -> None:
    flies = VehicleStatus(Control.IN_CONTROL, "PX4 flies by set-points (OFFBOARD)", "PX4", "OFFBOARD", True)
    told = items(policy, Come(who=flies))
    assert levels(told) == {"mode": "warn"} and "another program sends some" in told["mode"].sentence
    left = VehicleStatus(Control.TAKEN_OVER, "PX4 has left OFFBOARD for POSCTL", "PX4", "POSCTL", True)
    assert levels(items(policy, Come(who=left))) == {"mode": "warn"}


def test_a_dry_run_is_no_check_of_a_vehicle(policy: Policy) -> None:
    told = items(policy, Come(dry=True))
    assert levels(told) == {"autopilot": "warn"} and "autopilot=null is a dry run" in told["autopilot"].sentence
    assert not {"mode", "position", "pose age", "identity"} & set(told)


def test_no_pose(policy: Policy) -> None:
    told = items(policy, Come(pose=lambda n, now: None))
    assert levels(told) == dict.fromkeys(("position", "guards", "latency"), "fail")
    assert "look whether the autopilot's estimator has a position" in told["position"].sentence


def test_poses_that_are_old(policy: Policy) -> None:
    told = items(policy, Come(pose=lambda n, now: Pose(now - 0.3, (0.0, 0.0, 0.2), SPEED, 0.1, 0.01)))
    assert levels(told)["pose age"] == "fail"
    assert told["pose age"].sentence.startswith("Poses are 0.3 s old, and nothing is flown by one older than 0.1 s")


@pytest.mark.parametrize(
    ("pose", "says"),
    [
        (lambda n, now: Pose(now, (0.0, math.nan, 0.2), SPEED, 0.1, 0.01), "numbers that are not finite"),
        (lambda n, now: Pose(now, (20.0 * (n > 30), 0.0, 0.2), SPEED, 0.1, 0.01), "the position jumped by 20.0 m"),
        (lambda n, now: Pose(now, (0.0, 0.0, 0.2), SPEED, 1.6 * (n > 30), 0.01), "the yaw jumped by 92°"),
        (
            lambda n, now: Pose(now, (0.0, 0.0, 0.2), SPEED, 0.1, 0.01, resets=int(n > 30)),
            "the autopilot's estimator was",
        ),
        (lambda n, now: Pose(now, (0.2 * n, 0.0, 0.2), SPEED, 0.1, 0.01), "and the velocity says 0.0"),
    ],
)
def test_poses_that_are_not_plausible(policy: Policy, pose: Any, says: str) -> None:
    told = items(policy, Come(pose=pose))
    assert levels(told)["position"] == "fail" and says in told["position"].sentence.replace("The ", "the ")


def test_a_position_that_drifts(policy: Policy) -> None:
    told = items(policy, Come(pose=lambda n, now: Pose(now, (0.03 * n, 0.0, 0.2), (0.3, 0.0, 0.0), 0.1, 0.01)))
    assert levels(told) == {"position": "warn"} and "it moved by 1.8 m" in told["position"].sentence
    flies = VehicleStatus(Control.OTHER_MODE, "PX4 is in POSCTL, not in OFFBOARD", "PX4", "POSCTL", True)
    flown = Come(pose=lambda n, now: Pose(now, (0.03 * n, 0.0, 2.0), (0.3, 0.0, 0.0), 0.1, 0.01), who=flies)
    assert levels(items(policy, flown)) == {}


def test_the_fence(policy: Policy) -> None:
    limits = SafetyLimits(box=(-1.0, -1.0, 8.0, 1.0))
    told = items(policy, Come(), limits=limits)
    assert levels(told) == {"goal": "fail"}
    assert told["goal"].sentence.endswith("12.0 m outside the fence's wall: see goal= and safety.box=.")
    away = Come(pose=lambda n, now: Pose(now, (0.0, 4.0, 0.2), SPEED, 0.1, 0.01), goal=(5.0, 0.0, 2.5))
    told = items(policy, away, limits=limits)
    assert levels(told) == {"position": "fail"} and "3.0 m outside the fence's wall" in told["position"].sentence
    assert "and safety.ceiling=" in items(policy, Come(goal=(20.0, 0.0, 9.0)))["goal"].sentence


def test_scans_that_no_lidar_measures(policy: Policy) -> None:
    told = items(policy, Come(scan=lambda n: 1000.0 * ROOM))
    assert told["field of view"].level is Level.FAIL and "unit millimetres" in told["field of view"].sentence


def test_scans_that_do_not_move_as_the_pose_says(policy: Policy) -> None:
    """Somebody carries the vehicle, whose sensor repeats a scan."""
    speed = (2.0, 0.0, 0.0)
    carried = Come(pose=lambda n, now: Pose(now - 0.01, (0.2 * n, 0.0, 2.0), speed, 0.0, 0.01, 0.02), goal=(40.0, 0, 2))
    told = items(policy, carried)
    assert levels(told)["position"] == "fail" and "and stood by its scans" in told["position"].sentence


def test_guards_that_look_farther_than_the_sensor(policy: Policy) -> None:
    told = items(policy, sights={"evasion": 12.0}, guards="evasion", uses_motion=True)
    assert levels(told) == {"guards": "warn"}
    assert told["guards"].sentence.startswith("No return is farther than 6.0 m, and evasion looks up to 12 m")
    far = Come(scan=lambda n: np.linspace(13.0, 15.0, len(RAYS), dtype=np.float32)[:, None] * RAYS)
    told = items(policy, far, sights={"evasion": 12.0}, guards="evasion", uses_motion=True)
    assert levels(told) == {} and "(evasion) gave an action to 60 of 60 scans" in told["guards"].sentence


def test_guards_without_a_velocity(policy: Policy) -> None:
    still = Come(pose=lambda n, now: Pose(now, (0.0, 0.0, 0.2), (0.0, 0.0, 0.0), 0.1))
    assert levels(items(policy, still)) == {}, "the policy alone does not read them"
    told = items(policy, still, uses_motion=True)
    assert levels(told) == {"guards": "warn"}
    assert told["guards"].sentence.startswith("Velocity and roll and pitch are exactly 0 in each pose")


def test_a_guard_that_gives_no_action(policy: Policy) -> None:
    tilted = Come(pose=lambda n, now: Pose(now, (0.0, 0.0, 0.2), SPEED, 0.1, math.nan, 0.0), scan=lambda n: 15.0 * RAYS)
    told = items(policy, tilted, sights={"evasion": 12.0}, guards="evasion", uses_motion=True)
    assert told["guards"].level is Level.FAIL and told["guards"].sentence.startswith("The policy gave no action: ")


@pytest.mark.parametrize(("took", "level"), [(0.15, "fail"), (0.07, "warn")])
def test_a_computer_that_is_too_slow(policy: Policy, took: float, level: str) -> None:
    told = items(policy, Come(took=took))
    assert levels(told) == {"latency": level}
    assert f"{1000 * took:.1f} ms (99 %) on this computer, of 100 ms" in told["latency"].sentence


@pytest.mark.parametrize(
    ("free", "seconds", "level"),
    [(1e8, None, "fail"), (2e8, None, "warn"), (9e9, None, None), (1e8, 300.0, None), (1e7, 300.0, "fail")],
)
def test_room_for_the_log(
    policy: Policy,
    free: float,
    seconds: float | None,
    level: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=int(free)))
    told = items(policy, log=tmp_path / "flight.mcap", seconds=seconds)
    assert told["log"].level.value == (level or "pass") and f"{free / 1e9:.1f} GB are free" in told["log"].sentence
    assert list(tmp_path.iterdir()) == [], "nothing is left behind"


def test_a_log_that_cannot_be_written(policy: Policy, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    told = items(policy, log=tmp_path / "file" / "flight.mcap")
    assert levels(told) == {"log": "fail"} and "is no folder" in told["log"].sentence


class Radio:
    """What several components say on a MAVLink link."""

    def __init__(self, link: Autopilot) -> None:
        self._link = link

    def beat(self, system: int, component: int, kind: int, autopilot: int, key: bytes | None = None) -> None:
        writer = common.MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            writer.signing.secret_key, writer.signing.sign_outgoing = key, True
            writer.signing.timestamp = 10**15
        packed = common.MAVLink_heartbeat_message(kind, autopilot, 81, 4 << 16 | 3 << 24, 3, 3).pack(writer)
        for message in self._link._new_parser().parse_buffer(packed) or []:
            if message.get_type() == "BAD_DATA":
                self._link.vehicle.refused += 1
            else:
                self._link.vehicle.hear(message, START + 5.5)


@pytest.fixture
def link() -> Any:
    from tests.helpers.ports import free_ports

    with Autopilot(f"udp://127.0.0.1:{free_ports()[0]}") as opened:
        yield opened


def test_who_is_on_the_link(policy: Policy, link: Autopilot) -> None:
    radio = Radio(link)
    radio.beat(1, 1, 2, 12)
    radio.beat(1, 100, 30, 0)
    told = items(policy, link=link)
    assert levels(told) == {} and told["signing"].sentence == "The link is not signed."
    heard = "The vehicle is system 1, component 1; a camera (1/100) can be heard as well, and is left out."
    assert told["identity"].sentence == heard
    radio.beat(2, 1, 2, 12)
    status = link.status(START + 5.6)
    told = items(policy, Come(who=status), link=link)
    assert levels(told) == {"autopilot": "fail", "identity": "fail"}
    assert "2 vehicles send on this link" in told["identity"].sentence


def test_a_signed_link_without_its_key(policy: Policy, link: Autopilot) -> None:
    Radio(link).beat(1, 1, 2, 12, key=b"k" * 32)
    told = items(policy, Come(who=link.status(START + 5.6)), link=link)
    assert levels(told) == {"autopilot": "fail", "signing": "fail"}
    assert "give signing_key_file=" in told["signing"].sentence


def test_another_key(policy: Policy, tmp_path: Path) -> None:
    from tests.helpers.ports import free_ports

    (tmp_path / "key").write_bytes(b"a" * 32)
    with Autopilot(f"udp://127.0.0.1:{free_ports()[0]}", signing_key_file=str(tmp_path / "key")) as link:
        Radio(link).beat(1, 1, 2, 12, key=b"k" * 32)
        told = items(policy, Come(who=link.status(START + 5.6)), link=link)
    assert levels(told) == {"autopilot": "fail", "signing": "fail"}
    assert "No message bears a signature of signing_key_file=" in told["signing"].sentence
