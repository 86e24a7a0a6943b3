"""The items of a check before take-off: each is a function of what came, and one plain sentence."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import datetime, timezone

import numpy as np

from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import writable
from uavrl_onboard.flight.check import Evidence, Item, Level
from uavrl_onboard.flight.limits import distance_outside, outside_fence
from uavrl_onboard.flight.safety import Reason
from uavrl_onboard.geometry import hull_distances, is_inside, is_return
from uavrl_onboard.lidar.coverage import JUDGED, WATCHED
from uavrl_onboard.lidar.scans import BESIDE_SCANS, Skipped
from uavrl_onboard.lidar.summary import ScanSummary
from uavrl_onboard.lidar.vlp16 import NUM_RAYS
from uavrl_onboard.pluralize import pluralize

PASS, WARN, FAIL = Level.PASS, Level.WARN, Level.FAIL
UNHEARD = (Control.WAITING, Control.UNSUPPORTED, Control.AMBIGUOUS, Control.SIGNED, Control.LOST)
OWN = 0.9
"""Share of the scans with a return at the hull from which on it is the vehicle's own part."""
NEAR_HULL = 0.3
"""Distance from the hull within which steady returns are told, m."""
DRIFT = 0.5
"""Distance by which the position of a vehicle that is not armed may move in a check, m: `PoseCheck` takes no more."""
BUSY = 0.5
"""Share of a cycle that may be computed without a warning."""
LOST_PACKETS = 0.01
"""Share of lost packets from which on it is told; packet networks lose fewer."""
STEP = 0.5
"""Step of this computer's clock that is told, s: two readings of a busy computer lie less far apart."""
ROOM, HOUR = 600.0, 3600.0
"""Time for which the disk must have room, s, where the flight has no end of its own, and that without a warning."""
_LOG_SHARE = 1.1  # of a log, relative to its points
_BORN = 1_704_067_200.0  # s since 1970: 2024, before which no computer runs this
_SCANS = (Reason.NO_SCAN, Reason.OLD_SCAN, Reason.SCAN_AHEAD, Reason.CLOCK, Reason.LATE_CYCLE)
_POSE_AGES = (Reason.OLD_POSE, Reason.POSE_AHEAD)
_POSES = (
    Reason.POSE_NOT_FINITE,
    Reason.POSITION_FAR,
    Reason.POSITION_JUMPED,
    Reason.YAW_JUMPED,
    Reason.POSE_RESET,
    Reason.VELOCITY_DISAGREES,
)
_TOPICS = "uavrl_onboard.ros2.dds"  # the logger that tells of two nodes on one topic
_CLOCKS = "uavrl_onboard.autopilot.clock_sync"  # the logger that tells of clocks that have stepped


def check_goal(evidence: Evidence) -> Item:
    """The goal lies within the fence."""
    setup = evidence.setup
    outside, place = outside_fence(setup.goal, setup.limits), ", ".join(f"{each:g}" for each in setup.goal)
    if outside is not None:
        return Item("goal", FAIL, f"{outside}.")
    distance = evidence.cycles[-1].distance if evidence.cycles else None
    far = "" if distance is None else f", {distance:.1f} m away"
    return Item("goal", PASS, f"The goal ({place}) lies within the fence{far}.")


def check_scans(evidence: Evidence) -> Item:
    """Scans come, often enough and in time."""
    scans, told = evidence.scans, evidence.health.told
    if not scans:
        return Item("scans", FAIL, f"No scan has come in {evidence.seconds:.0f} s: {evidence.setup.feed.trouble()}")
    level, sentence = evidence.broken(evidence.scan_rules, evidence.settled(scans[0].time), _SCANS)
    if sentence:
        return Item("scans", level, f"Scans are missing or late: {sentence}.")
    if "slow" in told:
        return Item("scans", WARN, told["slow"])
    stamps = [cycle.scan.stamp for cycle in scans if cycle.scan is not None]
    rate = (len(stamps) - 1) / max(stamps[-1] - stamps[0], 1e-9)
    age = 1000.0 * float(np.median([cycle.time - cycle.scan.stamp for cycle in scans if cycle.scan is not None]))
    acts = evidence.setup.contract.rate_hz
    at_most = 1000.0 * evidence.setup.limits.scan_age
    read = f"{rate:.1f} scans per second are read, and the policy acts {acts:g} times"
    return Item("scans", PASS, f"{read}. They are {age:.0f} ms old (median); {at_most:.0f} ms are allowed.")


def check_packets(evidence: Evidence) -> Item | None:
    """What comes from the sensor is whole, of its model and of one sender."""
    shared = [sentence for name, sentence in evidence.warnings if name == _TOPICS]
    skipped, remarks = evidence.setup.feed.skipped, [*evidence.setup.feed.remarks(), *shared]
    if not evidence.scans:
        return None
    packets = sum(cycle.scan.packets for cycle in evidence.scans if cycle.scan is not None)
    counts = {name: count for name, count in asdict(skipped).items() if count and name not in BESIDE_SCANS}
    few = all(name in ("lost", "late") and count <= LOST_PACKETS * packets for name, count in counts.items())
    if remarks or not few:
        return Item("packets", WARN, " ".join([*remarks, *_left_out(skipped)]))
    lost = "nothing was left out" if not counts else "; ".join(skipped.sentences())
    return Item("packets", PASS, f"All scans come from one sender: {lost}.")


def _left_out(skipped: Skipped) -> list[str]:
    return [f"Left out: {'; '.join(skipped.sentences())}."] if skipped.sentences() else []


def check_view(evidence: Evidence) -> Item | None:
    """Scans cover their sensor's field of view."""
    if not evidence.scans:
        return None
    began = evidence.scans[0].time
    _, sentence = evidence.broken(evidence.scan_rules, evidence.settled(began), [Reason.HALF_SCAN, Reason.ODD_RANGES])
    if sentence:
        return Item("field of view", FAIL, f"{_capital(sentence)}.")
    if "doubt" in evidence.health.told:
        return Item("field of view", WARN, evidence.health.told["doubt"])
    summary, heights = ScanSummary(keep=1), []
    for cycle in evidence.scans:
        assert cycle.scan is not None
        summary.add(cycle.scan)
        points = cycle.scan.points[is_return(cycle.scan.points)]
        if len(points) >= JUDGED:
            heights.append(np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))))
    if len(heights) < WATCHED:
        few = f"Only {pluralize(len(heights), 'scan')} had {JUDGED} returns or more, too few to judge their directions"
        return Item("field of view", WARN, f"{few}: is anything within the sensor's range?")
    low, high = np.percentile(np.concatenate(heights), [0.1, 99.9])
    sectors = len(summary.sectors())
    return Item("field of view", PASS, f"Returns come from {sectors} of 8 directions, at {low:.0f}° to {high:.0f}°.")


def check_returns(evidence: Evidence) -> Item | None:
    """Scans hold returns."""
    if not evidence.scans:
        return None
    empty = evidence.broken(evidence.scan_rules, evidence.settled(evidence.scans[0].time), [Reason.EMPTY_SCANS])
    if empty[1]:
        return Item("returns", FAIL, f"{_capital(empty[1])}.")
    summary = ScanSummary(keep=1)
    for cycle in evidence.scans:
        assert cycle.scan is not None
        summary.add(cycle.scan)
    facts = summary.facts()
    median, misses, nearest = facts["points_median"] or 0.0, facts["misses"] or 0.0, facts["nearest_m"]
    near = "" if nearest is None else f"; the nearest is {nearest:.2f} m away"
    sentence = f"{100 * (1 - misses):.0f} % of the rays return, {median:,.0f} per scan (median){near}."
    if median < JUDGED:
        return Item("returns", WARN, f"{sentence} With fewer than {JUDGED} returns nobody can tell what is not seen.")
    return Item("returns", PASS, sentence)


def check_body(evidence: Evidence) -> Item | None:
    """The vehicle's own parts are not in its scans."""
    if not evidence.scans:
        return None
    vehicle, inside, gaps, boxes = evidence.setup.vehicle, [], [], []
    for cycle in evidence.scans:
        assert cycle.scan is not None
        seen = cycle.scan.points[is_return(cycle.scan.points)]
        points = np.asarray(seen, float) + np.array(vehicle.lidar_position)
        own = is_inside(points, vehicle.hull)
        inside.append(int(own.sum()))
        gaps.append(float(hull_distances(points, np.zeros((1, 3)), 0.0, vehicle.hull)[0]))
        boxes += [seen[own]] if own.any() else []
    hull = f"the hull (radius {vehicle.radius:g} m, height {vehicle.height:g} m)"
    if np.mean(np.array(inside) > 0) >= OWN:
        parts = np.concatenate(boxes)
        box = ",".join(f"{each:.2f}" for each in [*(parts.min(0) - 0.05), *(parts.max(0) + 0.05)])
        seen_in = f"Each scan holds {np.median(inside):.0f} returns (median) within {hull}"
        return Item("own body", FAIL, f"{seen_in}, which the policy takes for obstacles: pass vehicle=[{box}].")
    if np.mean(np.array(gaps) < NEAR_HULL) >= OWN:
        what = "are they the vehicle's own parts, which vehicle=[…] leaves out, or does something stand there?"
        return Item("own body", WARN, f"In each scan returns are {min(gaps):.2f} m from {hull} or nearer: {what}")
    return Item("own body", PASS, f"No steady returns come from within {NEAR_HULL:g} m of {hull}.")


def check_clock(evidence: Evidence) -> Item:
    """Stamps and this computer's clock run, and show the time."""
    told, now = evidence.health.told, _wall(evidence)
    day = datetime.fromtimestamp(now, timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    steps = [sentence for name, sentence in evidence.warnings if name == _CLOCKS]
    old = [told[kind] for kind in ("old scans", "old poses") if kind in told]
    if now < _BORN:
        wrong = "the log's times would be wrong, and signatures and stamps of other computers do not fit"
        return Item("clock", FAIL, f"This computer's clock says {day}: {wrong}. Set it, or wait for NTP.")
    if evidence.clock_step > STEP:
        stepped = f"This computer's clock was set by {evidence.clock_step:.1f} s during the check"
        return Item("clock", WARN, f"{stepped}: wait until NTP has settled, and check again.")
    if steps or old:
        return Item("clock", WARN, " ".join([*steps, *old]))
    return Item("clock", PASS, f"Stamps run with this computer's clock, which says {day}.")


def _wall(evidence: Evidence) -> float:
    return evidence.cycles[-1].time + evidence.clock if evidence.cycles else 0.0


def check_autopilot(evidence: Evidence) -> Item:
    """The vehicle is heard, and is one that can be flown."""
    status, setup = _status(evidence), evidence.setup
    if setup.link is None:
        return Item("autopilot", WARN, "No vehicle is checked: autopilot=null is a dry run.")
    if status.control in UNHEARD:
        return Item("autopilot", FAIL, f"{_capital(status.sentence)}.")
    armed = "armed" if status.armed else "not armed"
    firmware = f"{status.firmware}, {armed}" if status.firmware in ("PX4", "ArduPilot") else str(status.firmware)
    return Item("autopilot", PASS, f"The vehicle is heard: {firmware}.")


def check_mode(evidence: Evidence) -> Item | None:
    """The vehicle is in a mode from which it can be given to the policy."""
    status, setup = _status(evidence), evidence.setup
    if setup.link is None or status.control in UNHEARD:
        return None
    if status.control is Control.TAKEN_OVER:
        return Item("mode", WARN, f"{_capital(status.sentence)}: somebody changes it now.")
    if status.control is Control.IN_CONTROL and status.firmware == "PX4":
        stream = "no set-points come from here, so another program sends some"
        return Item("mode", WARN, f"{_capital(status.sentence)}: {stream}. End it first.")
    return Item("mode", PASS, f"{_capital(status.sentence)}.")


def check_identity(evidence: Evidence) -> Item | None:
    """Who is the vehicle, and who else speaks."""
    link = evidence.setup.link
    if not isinstance(link, Autopilot) or link.vehicle.source is None:
        return None
    system, component = link.vehicle.source
    roster = link.vehicle.roster
    also = [f"{name} ({number}/{part})" for (number, part), name in sorted(roster.others.items())]
    known = f"The vehicle is system {system}, component {component}"
    others = f"{known}; {', '.join(also)} can be heard as well, and is left out" if also else known
    if roster.rivals:
        return Item("identity", FAIL, f"{roster.which()}.")
    strange = [sentence for name, sentence in evidence.warnings if name == "uavrl_onboard.autopilot.mavlink"]
    return Item("identity", WARN if strange else PASS, " ".join([f"{others}.", *strange]))


def check_signing(evidence: Evidence) -> Item | None:
    """Whether the link is signed, with our key."""
    link, status = evidence.setup.link, _status(evidence)
    if not isinstance(link, Autopilot):
        return None
    if status.control is Control.SIGNED or link.vehicle.refused:
        told = (
            status.sentence if status.control in UNHEARD else f"{link.vehicle.refused} messages had another signature"
        )
        return Item("signing", FAIL, f"{_capital(told)}.")
    if link.vehicle.source is None:
        return None
    return Item("signing", PASS, "The link is signed with your key." if link.signs else "The link is not signed.")


def check_position(evidence: Evidence) -> Item | None:
    """The estimator has a plausible position."""
    poses, setup = evidence.poses, evidence.setup
    if setup.link is None:
        return None
    if not poses:
        told = evidence.health.told.get("late poses", "No position and attitude have come.")
        return Item("position", FAIL, told)
    _, sentence = evidence.broken(evidence.pose_rules, evidence.settled(poses[0].stamp), _POSES)
    sentence = sentence or evidence.flight.disagreement or ""
    if sentence:
        return Item("position", FAIL, f"{_capital(sentence)}.")
    places = np.array([pose.position for pose in poses])
    drift = float(np.linalg.norm(places - places[0], axis=1).max())
    x, y, z = places[-1]
    place = f"The vehicle is at ({x:.1f}, {y:.1f}, {z:.1f}) m and faces {math.degrees(poses[-1].yaw):.0f}°"
    if drift > DRIFT and not _status(evidence).armed:
        return Item(
            "position", WARN, f"{place}; it moved by {drift:.1f} m meanwhile. Wait for the estimator to settle."
        )
    outside, side = distance_outside(places[-1], setup.limits)
    if outside > setup.limits.margin and side != "floor":
        return Item("position", FAIL, f"{place}, {outside:.1f} m outside the fence's {side}: nothing is flown there.")
    below = f", {outside:.1f} m below the fence's floor, as before take-off" if outside > 0 and side == "floor" else ""
    return Item("position", PASS, f"{place}{below}.")


def check_pose_ages(evidence: Evidence) -> Item | None:
    """Poses come often enough, and in time."""
    poses, setup = evidence.poses, evidence.setup
    if setup.link is None or not poses:
        return None
    level, sentence = evidence.broken(evidence.pose_rules, evidence.settled(poses[0].stamp), _POSE_AGES)
    if sentence:
        return Item("pose age", level, evidence.health.told.get("late poses", f"{_capital(sentence)}."))
    ages = [1000.0 * (cycle.time - cycle.pose.stamp) for cycle in evidence.cycles if cycle.pose is not None]
    median, late = np.percentile(ages, [50, 99])
    at_most = f"{1000.0 * setup.limits.pose_age:.0f} ms are allowed"
    return Item("pose age", PASS, f"Poses are {median:.0f} ms old (median), {late:.0f} ms (99 %); {at_most}.")


def check_guards(evidence: Evidence) -> Item:
    """The policy and its guards give an action to what comes."""
    flight, setup, poses = evidence.flight, evidence.setup, evidence.poses
    acted = [cycle for cycle in evidence.scans if cycle.action is not None]
    if not acted:
        why = flight.refusal or "there is no scan or no pose to act on."
        return Item("guards", FAIL, f"The policy gave no action: {why}")
    if flight.refusal:
        return Item("guards", FAIL, f"At times the policy gave no action: {flight.refusal}")
    names = " and ".join(setup.sights)
    if setup.link is not None and setup.uses_motion:
        zero = [what for what, at in (("velocity", "velocity"), ("roll and pitch", "attitude")) if _is_zero(poses, at)]
        if zero:
            told = f"{_capital(' and '.join(zero))} are exactly 0 in each pose, and the guards or the policy need them"
            return Item("guards", WARN, f"{told}: does their sender fill them in?")
    farthest = max(_farthest(cycle) for cycle in evidence.scans)
    short = [f"{name} looks up to {sight:g} m" for name, sight in setup.sights.items() if farthest < sight]
    if short:
        cause = "is the sensor's or its driver's range cut off there, or is nothing farther away?"
        return Item("guards", WARN, f"No return is farther than {farthest:.1f} m, and {' and '.join(short)}: {cause}")
    guarded = f"The policy and its guards ({names})" if names else "The policy, without guards,"
    return Item("guards", PASS, f"{guarded} gave an action to {len(acted)} of {len(evidence.scans)} scans.")


def _is_zero(poses: Sequence[object], name: str) -> bool:
    values = [getattr(pose, name)[:2] if name == "attitude" else getattr(pose, name) for pose in poses]
    return bool(values) and not np.any(values)


def _farthest(cycle: object) -> float:
    points = cycle.scan.points  # type: ignore[attr-defined]
    far = points[is_return(points)]
    return float(np.sqrt((far**2).sum(-1)).max()) if len(far) else 0.0


def check_latency(evidence: Evidence) -> Item:
    """One cycle is computed in time on this computer."""
    acted = [cycle for cycle in evidence.scans if cycle.action is not None and cycle.latency is not None]
    acted = [cycle for cycle in acted if cycle.time >= evidence.settled(acted[0].time)]
    if not acted:
        return Item("latency", FAIL, "The time of a cycle cannot be measured: the policy gave no action.")
    period = 1000.0 * evidence.flight.period
    waited = [cycle.time - cycle.scan.stamp for cycle in acted if cycle.scan is not None]
    took = [1000.0 * ((cycle.latency or 0.0) - late) for cycle, late in zip(acted, waited, strict=True)]
    median, late = np.percentile(took, [50, 99])
    told = f"A cycle takes {median:.1f} ms (median) and {late:.1f} ms (99 %) on this computer, of {period:.0f} ms"
    if late > period:
        return Item("latency", FAIL, f"{told}: it cannot fly this policy in time. Look at the processor's load.")
    if late > BUSY * period:
        return Item("latency", WARN, f"{told}: look at the processor's load.")
    return Item("latency", PASS, f"{told}.")


def check_log(evidence: Evidence) -> Item:
    """The disk has room for the log."""
    setup, scans = evidence.setup, evidence.scans
    if setup.log is None:
        return Item("log", PASS, "No log is written: log=null.")
    try:
        free = shutil.disk_usage(writable(setup.log, "log=FILE").absolute().parent).free
    except UavrlError as error:
        return Item("log", FAIL, str(error))
    points = [len(cycle.scan.points) for cycle in scans if cycle.scan is not None]
    rate = _LOG_SHARE * 12 * (float(np.median(points)) if points else NUM_RAYS) * setup.contract.rate_hz
    lasts, least = free / rate, setup.seconds or ROOM
    told = f"{free / 1e9:.1f} GB are free, enough for {lasts / 60:,.0f} minutes of log at {rate / 1e6:.1f} MB/s"
    if lasts < least:
        return Item("log", FAIL, f"{told}: make room, or name another disk with log=FILE.")
    if lasts < min(HOUR, setup.seconds or HOUR):
        return Item("log", WARN, f"{told}.")
    return Item("log", PASS, f"{told}.")


def _status(evidence: Evidence) -> VehicleStatus:
    return evidence.statuses[-1] if evidence.statuses else VehicleStatus(Control.WAITING, "nothing was read")


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


CHECKS: tuple[Callable[[Evidence], Item | None], ...] = (
    check_goal,
    check_scans,
    check_packets,
    check_view,
    check_returns,
    check_body,
    check_clock,
    check_autopilot,
    check_mode,
    check_identity,
    check_signing,
    check_position,
    check_pose_ages,
    check_guards,
    check_latency,
    check_log,
)
"""In the order in which they are told."""


def judge(evidence: Evidence) -> list[Item]:
    """Return the items of a check that concern what came; one that depends on a missing thing is left to that."""
    return [item for check in CHECKS if (item := check(evidence)) is not None]
