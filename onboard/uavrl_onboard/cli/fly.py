"""``uavrl-fly``: an exported policy flies a vehicle by its LiDAR, or pretends to."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from uavrl_onboard.autopilot.dry_run import DryRun
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.cli.command import command
from uavrl_onboard.cli.flight_end import conclude, until_the_end, writes
from uavrl_onboard.cli.flight_lines import FlightLines
from uavrl_onboard.cli.help import About
from uavrl_onboard.cli.lidar_keys import LidarKeys
from uavrl_onboard.cli.nonblocking_output import nonblocking_output
from uavrl_onboard.cli.process import terminable
from uavrl_onboard.cli.ros2_keys import ROS2, Ros2Config, ros2_feed, ros2_link, ros2_reports
from uavrl_onboard.errors import Stopped, UavrlError
from uavrl_onboard.files import writable
from uavrl_onboard.flight.health import FlightHealth
from uavrl_onboard.flight.interfaces import FlightCycle, VehicleLink
from uavrl_onboard.flight.limits import SafetyLimits, outside_fence
from uavrl_onboard.flight.log import FlightLog
from uavrl_onboard.flight.loop import Flight, fly, rehearse
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.flight.summary import FlightSummary
from uavrl_onboard.guards.chain import Guards
from uavrl_onboard.guards.settings import GuardSettings, guard_settings
from uavrl_onboard.lidar.mount import TILTED, mount_tilt
from uavrl_onboard.lidar.sources import ScanSource
from uavrl_onboard.lidar.udp_scans import UdpScans
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.ranges import Folder, NonNegative, Positive
from uavrl_onboard.sentences import require
from uavrl_onboard.vehicle import VEHICLE, Vehicle

if TYPE_CHECKING:
    from uavrl_onboard.ros2.vehicle import Ros2Scans


@dataclass
class HullConfig:
    """The vehicle's hull, an upright cylinder, as guards assume it.

    Args:
        radius: radius of the hull, in m; null: as in the policy's contract
        height: height of the hull, in m; null: as in the policy's contract
        sensor: height of the LiDAR above the hull's middle, on its axis, in m; null: as in the policy's contract
        elevations: [lowest,highest] ray of the LiDAR as it is mounted, in degrees, between which evasion looks for
            moving objects, and which its returns must cover, [0,0] for a 2-D LiDAR; null: as in the policy's contract
        repeats: whether each scan of the LiDAR has the same rays, false for a Livox; null: as in the policy's contract
    """

    radius: Positive | None = None
    height: Positive | None = None
    sensor: float | None = None
    elevations: tuple[float, float] | None = None
    repeats: bool | None = None


@dataclass
class FlyConfig(LidarKeys):
    """The keys of ``uavrl-fly``.

    Args:
        policy: folder that uavrl-export wrote, with policy.onnx
        goal: [x,y,z] in m from the autopilot's origin: east, north, up; z is the middle of the goal's height
        lidar: address that the sensor sends to, udp://:2368, or udp://:7502 for an Ouster; ros2:///TOPIC for point
            clouds of a ROS 2 driver; for a dry run also a recording, as uavrl-scan reads it
        autopilot: address that PX4 or ArduPilot sends MAVLink to; ros2:///odom for a vehicle of ROS 2; null for a dry
            run, which sends nothing
        set_mode: ask the autopilot for Offboard (PX4) or GUIDED (ArduPilot); false: the pilot chooses the mode
        arm: ask the autopilot to arm, once in that mode
        system: MAVLink system id of the vehicle; null: the first vehicle heard
        signing_key_file: file with the key of a signed MAVLink link, 32 bytes or 64 hexadecimal digits; null: unsigned
        standing: pose of the vehicle in a dry run: x, y, z in m, yaw from east to the left in rad
        radius: horizontal distance from the goal, in m, at which the vehicle has arrived; it then hovers there
        hold: time of hovering at the goal before the flight ends, in s; null: until Ctrl-C, or until the pilot takes
            over
        seconds: time after which the flight ends, wherever the vehicle is, in s; null: never
        log: file for the flight log; null: none
        json: file for the flight's numbers; null: none
        progress: print a line each second
        ros2: set-points and reports by ROS 2
        guards: filters between the policy and the vehicle: all, none, or a list of map, evasion and shield; settings
            are written guards.shield.margin=0.2; null: as in the policy's contract
        hull: the vehicle's hull
        safety: limits of the safety layer
    """

    policy: Folder | None = None
    goal: tuple[float, ...] | None = None
    lidar: Folder = "udp://:2368"
    autopilot: Folder | None = "udp://:14540"
    set_mode: bool = False
    arm: bool = False
    system: Annotated[int, Field(ge=1, le=255)] | None = None
    signing_key_file: Folder | None = None
    standing: tuple[float, float, float, float] = (0.0, 0.0, VEHICLE.flight_level, 0.0)
    radius: Positive = 1.0
    hold: NonNegative | None = None
    seconds: Positive | None = None
    log: Folder | None = "flight.mcap"
    json: Folder | None = None
    progress: bool = True
    ros2: Ros2Config = field(default_factory=Ros2Config)
    guards: Any = None
    hull: HullConfig = field(default_factory=HullConfig)
    safety: SafetyLimits = field(default_factory=SafetyLimits)

    def __post_init__(self) -> None:
        """Checks that it knows what flies where, and that a recording flies nothing."""
        super().__post_init__()
        require(self.policy is not None, "policy", "a folder that uavrl-export wrote", self.policy)
        goal = self.goal is not None and len(self.goal) == 3
        require(goal, "goal", "three numbers, [x,y,z] in m from the autopilot's origin", self.goal)
        guard_settings(self.guards, GuardSettings.all())  # names and values; which ones are on, the contract says
        rays = self.hull.elevations
        sound = rays is None or -90.0 <= rays[0] <= rays[1] <= 90.0
        require(sound, "hull.elevations", "[lowest,highest] in [-90, 90] degrees", rays)
        dry = self.autopilot is None or self.is_live
        require(dry, "lidar", "a sensor, udp://:2368: a recording flies nothing but autopilot=null", self.lidar)
        asked = [key for key in ("set_mode", "arm", "system", "signing_key_file") if getattr(self, key)]
        by_ros = self.autopilot is not None and self.autopilot.startswith(ROS2)
        able = not (by_ros and asked)
        require(able, "autopilot", f"udp://:14540 with {' and '.join(asked)}: only MAVLink has that", self.autopilot)

        others = {Path(each).resolve() for each in (self.log, None if self.is_live else self.lidar) if each is not None}
        json = None if self.json is None else Path(self.json).resolve()
        apart = json is None or others.isdisjoint([json, *json.parents])
        require(apart, "json", "another file than the log and the recording, which it would replace", self.json)

    @property
    def is_live(self) -> bool:
        """Whether a sensor sends now."""
        return self.lidar.startswith(("udp:", ROS2))


ABOUT = About(
    "uavrl-fly",
    "Flies a vehicle with an exported policy, its LiDAR and its autopilot, or rehearses a flight.",
    [
        "policy=FOLDER model=VLP16 goal=[20,5,2.5] set_mode=true",
        "policy=FOLDER model=VLP16 goal=[20,0,2.5] autopilot=null",
    ],
    "policy goal lidar model metadata mount vehicle autopilot set_mode arm standing radius hold seconds log json",
)


@command(ABOUT, FlyConfig)
def main(settings: FlyConfig) -> None:
    """Flies until it has ended, prints how, and writes the numbers."""
    assert settings.goal is not None
    if (outside := outside_fence(settings.goal, settings.safety)) is not None:
        raise UavrlError(f"{outside}.")
    policy = Policy(str(settings.policy))
    policy.fly_with(make_vehicle(settings, policy))
    numbers = None if settings.json is None else writable(Path(settings.json), "json=FILE")
    if settings.safety.floor < 0.0 and settings.autopilot is not None:
        print("safety.floor is below the ground, for a bench without propellers: never fly so.", file=sys.stderr)
    summary, lines, stopped = FlightSummary(), FlightLines(), None
    with ExitStack() as opened:
        if numbers is not None:
            opened.push(writes(summary, numbers))  # comes last
        if settings.is_live:
            opened.enter_context(nonblocking_output())
        link = opened.enter_context(closing(open_link(settings)))
        guards = make_guards(settings, policy)
        layer, moves = SafetyLayer(settings.safety), settings.autopilot is not None
        more: dict[str, Any] = {"radius": settings.radius, "guards": guards, "moves": moves}
        more |= {"rotation": settings.rotation, "box": settings.box}
        flight = Flight(policy, settings.goal, link, layer, **more)
        print(f"Guards: {', '.join(guards.settings.names) or 'none'}.", flush=True)
        log = _log(settings, policy, guards)
        if log is not None:
            opened.callback(_told, log.close)
        cycles, report = _cycles(settings, flight, link, opened), _reports(settings, policy, link, opened)
        try:
            with terminable():
                for cycle in until_the_end(cycles, settings.hold, settings.seconds):
                    summary.add(cycle)
                    report(cycle)
                    if log is not None:
                        _told(log.write, cycle)
                    if settings.progress and (line := lines.of(cycle, summary)) is not None:
                        print(line, flush=True)
        except KeyboardInterrupt as error:
            stopped = error
        finally:
            if summary.cycles:
                conclude(summary.facts(), log)
    if stopped is not None:
        number = getattr(stopped, "number", signal.SIGINT)
        raise Stopped("stopped: no more set-points are sent.", number) from stopped


def open_link(settings: FlyConfig, **instead: Any) -> VehicleLink:
    """Return the way to the vehicle, or to none in a dry run; ``instead`` of settings of MAVLink."""
    if settings.autopilot is None:
        x, y, z, yaw = settings.standing
        return DryRun((x, y, z), yaw)
    if settings.autopilot.startswith(ROS2):
        return ros2_link(settings.autopilot, settings.ros2)
    told = {key: getattr(settings, key) for key in ("set_mode", "arm", "system", "signing_key_file")}
    return Autopilot(settings.autopilot, **told | instead)


def _log(settings: FlyConfig, policy: Policy, guards: Guards) -> FlightLog | None:
    if settings.log is None:
        return None
    assert settings.goal is not None
    about = {"lidar": settings.lidar, "autopilot": str(settings.autopilot)}
    about |= {"guards": json.dumps(guards.settings.plain()), "mount": json.dumps(settings.mount)}
    return FlightLog(
        settings.log, policy.contract, settings.goal, radius=settings.radius, live=settings.is_live, about=about
    )


def _told(write: Callable[..., None], *arguments: FlightCycle) -> None:
    """Writes to the log; where that fails, says so and flies on."""
    try:
        write(*arguments)
    except UavrlError as error:
        print(f"uavrl: {error}", file=sys.stderr)


def make_guards(settings: FlyConfig, policy: Policy) -> Guards:
    """Return the guards of a flight: those of the command line, or else of the policy's contract."""
    chosen = guard_settings(settings.guards, policy.contract.guard_settings)
    if (tilt := mount_tilt(settings.mount)) > TILTED:
        told = f"mount={list(settings.mount)} tilts the LiDAR by {tilt:.0f} degrees, so static obstacles at the edge of"
        why = "its field of view seem to move when the vehicle turns"
        if policy.contract.motion is not None:
            raise UavrlError(f"{told} {why}: this policy looks for moving objects, so mount the LiDAR level.")
        if chosen.evasion is not None:
            others = ",".join(name for name in chosen.names if name != "evasion")
            raise UavrlError(f"{told} {why}: leave evasion out (guards={f'[{others}]' if others else 'none'}).")
    return Guards(chosen, 1, make_vehicle(settings, policy))


def make_vehicle(settings: FlyConfig, policy: Policy) -> Vehicle:
    """Return the policy's vehicle with the hull and the LiDAR of the command line, within all limits."""
    hull, limits, trained = settings.hull, settings.safety, policy.contract.vehicle
    return replace(
        trained,
        radius=hull.radius or trained.radius,
        height=hull.height or trained.height,
        lidar_position=trained.lidar_position if hull.sensor is None else (0.0, 0.0, hull.sensor),
        lidar_elevations=hull.elevations or trained.lidar_elevations,
        lidar_repeats=trained.lidar_repeats if hull.repeats is None else hull.repeats,
        velocity_limit=min(limits.velocity, trained.velocity_limit),
        yaw_rate_limit=min(limits.yaw_rate, trained.yaw_rate_limit),
    )


def _cycles(settings: FlyConfig, flight: Flight, link: VehicleLink, opened: ExitStack) -> Iterator[FlightCycle]:
    """The flight's cycles, from a sensor or a recording."""
    if not settings.is_live:
        keys = {key: getattr(settings, key) for key in ("topic", "product", "metadata")}
        source = ScanSource(settings.lidar, settings.model, **keys)
        settings.require_unturned(source)
        opened.callback(_tell_skipped, source)
        return _with_health(rehearse(flight, source, link), FlightHealth(lambda: "", 1.0 / flight.period))
    feed = opened.enter_context(closing(open_feed(settings, link)))
    health = FlightHealth(
        feed.trouble,
        1.0 / flight.period,
        settings.safety.pose_age,
        stamped=settings.lidar.startswith(ROS2),
        remarks=feed.remarks,
    )
    return _with_health(fly(flight, feed, link), health)


def _tell_skipped(source: ScanSource) -> None:
    """Says what of a recording was left out, and what is odd about it."""
    for sentence in source.remarks():
        print(f"uavrl: {sentence}", file=sys.stderr)


def open_feed(settings: FlyConfig, link: VehicleLink) -> UdpScans | Ros2Scans:
    """Return the scans of the sensor."""
    if settings.lidar.startswith(ROS2):
        return ros2_feed(settings.lidar, link)
    return UdpScans(settings.lidar, settings.model, settings.product, settings.metadata)


def _reports(settings: FlyConfig, policy: Policy, link: VehicleLink, opened: ExitStack) -> Callable[[FlightCycle], Any]:
    """What publishes a cycle to ROS 2, if that is asked for."""
    if not settings.ros2.diagnostics and not settings.ros2.markers:
        return lambda cycle: None
    assert settings.goal is not None
    addresses = [str(settings.autopilot), settings.lidar]
    reports = ros2_reports(
        settings.ros2, addresses, link, policy.contract, settings.goal, settings.radius, settings.safety
    )
    return opened.enter_context(reports).tell


def _with_health(cycles: Iterable[FlightCycle], health: FlightHealth) -> Iterator[FlightCycle]:
    """The same cycles; prints what is odd about their scans and poses."""
    for cycle in cycles:
        yield cycle
        for sentence in health.sentences(cycle):
            print(sentence, flush=True)


if __name__ == "__main__":
    main()
