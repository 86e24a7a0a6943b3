"""The log of a flight: what is written is read back, by us and by others, also where it ends in the middle."""

from __future__ import annotations

import errno
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.helpers.logged import ATTITUDE, GOAL, SILENT, START, YAW, contract, cycles, write_log

from uavrl_onboard.autopilot.vehicle_state import Control, VehicleStatus
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log import FlightLog
from uavrl_onboard.flight.log_messages import (
    ACTION,
    CELLS,
    CHANGES,
    NUMBERS,
    POINTS,
    POSE,
    SETPOINT,
    STATUS,
    TOPICS,
    VELOCITY,
    FlightMessages,
)
from uavrl_onboard.flight.logged_flight import LoggedFlight
from uavrl_onboard.flight.safety import SafetyState
from uavrl_onboard.lidar.sources import ScanSource

NEAR = {"abs": 2e-9}  # s: a log's times are whole nanoseconds


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[FlightCycle]]:
    return write_log(tmp_path_factory.mktemp("log") / "flight.mcap")


def same(found: FlightCycle, written: FlightCycle) -> None:
    """Checks that a cycle is what was written."""
    assert found.time == pytest.approx(written.time, **NEAR)
    for name in ("cells", "action"):
        was, now = getattr(written, name), getattr(found, name)
        assert (was is None) == (now is None)
        if was is not None:
            np.testing.assert_array_equal(now, was, err_msg=name)
    assert (found.scan is None) == (written.scan is None) and (found.pose is None) == (written.pose is None)
    if found.scan is not None and written.scan is not None:
        np.testing.assert_array_equal(found.scan.points, written.scan.points)
        assert (found.scan.rays, found.scan.misses) == (written.scan.rays, written.scan.misses)
        assert found.scan.stamp == pytest.approx(written.scan.stamp, **NEAR)
    if found.pose is not None and written.pose is not None:
        assert found.pose.stamp == pytest.approx(written.pose.stamp, **NEAR)
        assert (found.pose.position, found.pose.velocity) == (written.pose.position, written.pose.velocity)
        for angle in ("yaw", "roll", "pitch"):
            assert getattr(found.pose, angle) == pytest.approx(getattr(written.pose, angle), abs=1e-12)
    for name in ("distance", "control", "status", "latency", "arrived", "turn"):
        assert getattr(found, name) == getattr(written, name), name


def test_every_quantity_of_every_cycle_comes_back(logged: tuple[Path, list[FlightCycle]]) -> None:
    path, written = logged
    flight = LoggedFlight(path)
    assert flight.contract == contract() and flight.goal == GOAL
    assert flight.sensor_position == contract().cloud.sensor_position
    assert json.loads(flight.about["versions"])["uavrl-onboard"]
    found = list(flight)
    assert (flight.whole, flight.left_out, flight.radius) == (True, 0, 1.0)
    assert len(found) == len(written) == 60
    for one, other in zip(found, written, strict=True):
        same(one, other)
    assert {cycle.status.state for cycle in found} == {
        SafetyState.SILENT,
        SafetyState.STANDBY,
        SafetyState.FLYING,
        SafetyState.HOLDING,
    }


@pytest.mark.parametrize("yaw", [math.pi, -math.pi, -3.0, 1e-3, math.nan])
def test_any_yaw_and_numbers_that_are_not_finite_come_back(yaw: float, tmp_path: Path) -> None:
    cycle = list(cycles(4))[3]
    assert cycle.pose is not None
    pose = replace(cycle.pose, yaw=yaw, position=(math.nan, math.inf, 1.0))
    odd = replace(cycle, pose=pose, action=np.array([math.nan, 0.0, math.inf, 0.0]), distance=math.nan)
    with FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START) as log:
        log.write(odd)
    (found,) = LoggedFlight(log.path)
    assert found.pose is not None and found.distance is None
    np.testing.assert_allclose(found.pose.yaw, yaw, atol=1e-12)
    np.testing.assert_array_equal(found.pose.position, pose.position)
    np.testing.assert_array_equal(found.action, odd.action)


@pytest.mark.parametrize("roll", [math.nan, math.inf])
def test_a_vehicle_whose_roll_is_none_is_logged_level(roll: float, tmp_path: Path) -> None:
    cycle = list(cycles(4))[3]
    assert cycle.pose is not None
    with FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START) as log:
        log.write(replace(cycle, pose=replace(cycle.pose, roll=roll)))
        log.write(replace(cycle, pose=replace(cycle.pose, yaw=roll)))
    level, unknown = LoggedFlight(log.path)
    assert level.pose is not None and unknown.pose is not None and log.left_out == 0
    assert (level.pose.yaw, level.pose.roll, level.pose.pitch) == pytest.approx((YAW, 0.0, 0.0))
    assert math.isnan(unknown.pose.yaw) and unknown.pose.position == cycle.pose.position


def test_the_libraries_of_others_read_the_same(logged: tuple[Path, list[FlightCycle]]) -> None:
    path, written = logged
    store: Any = get_typestore(Stores.EMPTY)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        messages = [(schema, channel, message) for schema, channel, message in reader.iter_messages()]
        names = [record.name for record in reader.iter_metadata()]
        (attached,) = reader.iter_attachments()
    assert names == ["uavrl.flight", "uavrl.end"] and attached.name == "contract.json"
    assert json.loads(attached.data) == json.loads(contract().model_dump_json())
    known = {channel.topic: (schema, channel) for schema, channel, _ in messages}
    for schema, channel in known.values():  # the definitions in the file are complete: another's parser knows all types
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        assert schema.name == TOPICS[channel.topic]
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
    by_topic: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in TOPICS}
    for schema, channel, message in messages:
        by_topic[channel.topic].append((message.log_time, store.deserialize_cdr(message.data, schema.name)))
    flown = [cycle for cycle in written if cycle.pose is not None]
    assert len(by_topic[STATUS]) == 60 and len(by_topic[POSE]) == len(by_topic[VELOCITY]) == 57
    assert len(by_topic[POINTS]) == len(by_topic[CELLS]) == 60 - (SILENT[1] - SILENT[0])
    times = np.array([stamp for stamp, _ in by_topic[STATUS]])
    np.testing.assert_allclose(np.diff(times), 1e8, atol=2)
    assert abs(times[0] / 1e9 - time.time()) < 600, "the time of the day"
    for (_, message), cycle in zip(by_topic[POSE], flown, strict=True):
        at, turned = message.pose.position, message.pose.orientation
        assert cycle.pose is not None and message.header.frame_id == "world"
        assert (at.x, at.y, at.z) == cycle.pose.position
        np.testing.assert_allclose([turned.x, turned.y, turned.z, turned.w], ATTITUDE.as_quat(), atol=1e-12)
    for topic, actions in {
        ACTION: [cycle.action for cycle in flown],
        SETPOINT: [cycle.status.setpoint for cycle in written if cycle.status.setpoint is not None],
    }.items():
        for (_, message), action in zip(by_topic[topic], actions, strict=True):
            linear, angular = message.twist.linear, message.twist.angular
            assert message.header.frame_id == "vehicle"
            np.testing.assert_array_equal([linear.x, linear.y, linear.z, angular.z], action)
    said = json.loads(by_topic[STATUS][-1][1].data)
    assert said["safety"] == json.loads(json.dumps(asdict(written[-1].status)))
    for (_, message), cycle in zip(by_topic[NUMBERS], written, strict=True):
        named = {"state": cycle.status.state, "reason": cycle.status.reason, "control": cycle.control.control}
        for name, value in named.items():
            assert getattr(message, name) == getattr(message, f"{name}_{value}".upper())
        measured = (cycle.status.scan_age, cycle.status.pose_age, cycle.latency, cycle.distance)
        expected = [math.nan if each is None else each for each in measured]
        found = [message.scan_age, message.pose_age, message.latency, message.distance]
        np.testing.assert_array_equal(found, expected)
        assert message.arrived == cycle.arrived
    changed = [cycle.status for cycle in written if cycle.status.changed]
    assert [message.msg for _, message in by_topic[CHANGES]] == [
        f"{s.state} ({s.reason}): {s.sentence}" for s in changed
    ]
    assert len(by_topic["/uavrl/goal"]) == 6, "once a second"


def test_the_frames_put_the_cloud_into_the_world(logged: tuple[Path, list[FlightCycle]]) -> None:
    path, written = logged
    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(path) as bag:
        frames = [
            store.deserialize_cdr(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic == "/tf"
        ]
    assert len(frames) == 60 and len(frames[0].transforms) == 1 and len(frames[-1].transforms) == 2
    sensor, vehicle = frames[-1].transforms
    assert (sensor.header.frame_id, sensor.child_frame_id) == ("vehicle", "lidar")
    assert (vehicle.header.frame_id, vehicle.child_frame_id) == ("world", "vehicle")
    offset, place = sensor.transform.translation, vehicle.transform.translation
    np.testing.assert_allclose([offset.x, offset.y, offset.z], contract().cloud.sensor_position)
    cycle = written[-1]
    assert cycle.pose is not None and (place.x, place.y, place.z) == cycle.pose.position
    for turn, wanted in ((vehicle.transform.rotation, ATTITUDE.as_quat()), (sensor.transform.rotation, (0, 0, 0, 1))):
        np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], wanted, atol=1e-12)


def test_a_log_is_a_source_of_scans(logged: tuple[Path, list[FlightCycle]]) -> None:
    path, written = logged
    scans = [cycle.scan for cycle in written if cycle.scan is not None]
    source = ScanSource(path)
    for found, scan in zip(source, scans, strict=True):
        np.testing.assert_array_equal(found.points, scan.points)
    assert not source.skipped.sentences()


@pytest.mark.parametrize("share", [0.999, 0.7, 0.3])
def test_a_log_that_ends_in_the_middle_is_read_up_to_there(
    share: float, logged: tuple[Path, list[FlightCycle]], tmp_path: Path
) -> None:
    path, written = logged
    content = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(share * len(content))])
    flight = LoggedFlight(cut)
    found = list(flight)
    assert not flight.whole or share > 0.99
    assert 45 * share < len(found) <= 60
    for one, other in zip(found, written, strict=False):
        same(one, other)
    source = ScanSource(cut)
    scans = list(source)
    assert abs(len(scans) - sum(cycle.scan is not None for cycle in found)) <= 1
    assert bool(source.skipped.malformed) != flight.whole, "uavrl-scan says that something is missing"


def test_what_was_written_is_soon_in_the_file_of_a_loop_that_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavrl_onboard.flight.log.FLUSH", 0.1)
    log = FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START)
    flown = list(cycles(13))
    for cycle in flown:
        log.write(cycle)
    until = time.monotonic() + 60.0
    while len(list(LoggedFlight(log.path))) < 13 and time.monotonic() < until:
        time.sleep(0.05)
    flight = LoggedFlight(log.path)  # nobody has closed the log
    found = list(flight)
    assert len(found) == 13 and not flight.whole
    log.close()


def test_no_log_replaces_another(tmp_path: Path) -> None:
    first, _ = write_log(tmp_path / "flight.mcap", 2)
    content = first.read_bytes()
    second, _ = write_log(tmp_path / "flight.mcap", 3)
    third, _ = write_log(tmp_path / "flight.mcap", 4)
    assert [path.name for path in (first, second, third)] == ["flight.mcap", "flight_2.mcap", "flight_3.mcap"]
    assert first.read_bytes() == content and len(list(LoggedFlight(third))) == 4


def test_a_full_disk_is_told_once_and_stops_no_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavrl_onboard.flight.log.FLUSH", 0.01)
    log = FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START)
    flown = list(cycles(20))
    said = list[str]()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("uavrl_onboard.flight.log.os.fsync", full)

    def write_all() -> None:
        for cycle in flown:
            try:
                log.write(cycle)
            except UavrlError as error:
                said.append(str(error))
            time.sleep(0.005)

    until = time.monotonic() + 60.0
    while not said and time.monotonic() < until:  # its thread saves when the machine lets it
        write_all()
    write_all()
    log.close()
    why = "No space left on device"
    assert said == [f"{log.path} cannot be written any more ({why}): the log has ended, and holds what came before."]


def test_a_disk_that_hangs_holds_nothing_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavrl_onboard.flight.log.FLUSH", 0.01)
    log = FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START)
    (cycle,) = cycles(1)
    hangs, goes_on, over = threading.Event(), threading.Event(), threading.Event()
    monkeypatch.setattr("uavrl_onboard.flight.log.os.fsync", lambda _: (hangs.set(), goes_on.wait(60.0), over.set()))
    log.write(cycle)
    assert hangs.wait(60.0), "the thread saves"
    for _ in range(70):
        log.write(cycle)
    assert not over.is_set(), "all was taken while the disk hung"
    goes_on.set()
    log.close()
    flight = LoggedFlight(log.path)
    assert len(list(flight)) + flight.left_out == 71


def test_where_no_file_can_be_made_or_a_library_is_missing_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UavrlError, match=r"cannot be written .*: choose another file for the log"):
        FlightLog(tmp_path / "file" / "f.mcap", contract(), GOAL)
    for folder in (tmp_path, "."):  # a dot has no name that a number could be added to
        with pytest.raises(UavrlError, match=r"cannot be written \(it is a folder\): choose another file"):
            FlightLog(folder, contract(), GOAL)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(UavrlError, match=r"A flight log needs mcap: pip install 'uavrl-onboard\[log\]'\.$"):
        FlightLog(tmp_path / "f.mcap", contract(), GOAL)
    assert not (tmp_path / "f.mcap").exists()


def foreign(path: Path, write: Callable[[Any], None] = lambda writer: None) -> Path:
    """An MCAP file of somebody else."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        write(writer)
        writer.finish()
    return path


def test_what_is_no_log_ends_in_one_sentence(tmp_path: Path, logged: tuple[Path, list[FlightCycle]]) -> None:
    path, _ = logged
    content = path.read_bytes()
    (tmp_path / "text.mcap").write_text("no MCAP")
    (tmp_path / "head.mcap").write_bytes(content[:60])
    foreign(tmp_path / "foreign.mcap", lambda writer: writer.add_metadata("other", {"a": "b"}))

    def later(writer: Any) -> None:
        writer.add_metadata("uavrl.flight", {"format": "uavrl.flight 9"})
        writer.add_attachment(0, 0, "contract.json", "application/json", b"{}")

    def damaged(writer: Any) -> None:
        writer.add_metadata("uavrl.flight", {"format": "uavrl.flight 1", "goal": "[1,2]"})
        writer.add_attachment(0, 0, "contract.json", "application/json", b"{}")

    def earlier(writer: Any) -> None:
        terms = json.loads(contract().to_text())
        del terms["cells"]["offsets"]
        writer.add_metadata("uavrl.flight", {"format": "uavrl.flight 1", "goal": "[1,2,3]"})
        writer.add_attachment(0, 0, "contract.json", "application/json", json.dumps(terms).encode())

    for name, write, said in (
        ("earlier", earlier, "was written by an earlier uavrl: its contract has no cells.offsets, and what it saw"),
        ("nowhere", None, "nowhere.mcap cannot be read"),
        ("text", None, "text.mcap is no MCAP file"),
        ("head", None, "is an MCAP file, and not the log of a flight"),
        ("foreign", None, "is an MCAP file, and not the log of a flight"),
        ("nine", later, "is not of uavrl.flight 1, which this version of uavrl reads"),
        ("damaged", damaged, "The head of .* is damaged"),
    ):
        if write is not None:
            foreign(tmp_path / f"{name}.mcap", write)
        with pytest.raises(UavrlError, match=said):
            LoggedFlight(tmp_path / f"{name}.mcap")


@pytest.mark.parametrize("seed", range(3))
def test_damaged_bytes_end_in_what_is_whole_or_in_a_sentence(
    seed: int, logged: tuple[Path, list[FlightCycle]], tmp_path: Path
) -> None:
    content, chance = logged[0].read_bytes(), np.random.default_rng(seed)
    for trial in range(20):
        damaged = np.frombuffer(content, np.uint8).copy()
        end = 40_000 if trial % 2 else len(damaged)  # the head, which no checksum protects, or anywhere
        damaged[chance.integers(9, end, 3)] = chance.integers(0, 256, 3, np.uint8)
        path = tmp_path / "damaged.mcap"
        path.write_bytes(damaged.tobytes())
        try:
            assert len(list(LoggedFlight(path))) <= 60
        except UavrlError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize(
    "change",
    [
        {"cells": np.zeros(7, np.float32)},
        {"distance": "far"},
        {"latency": [1]},
        {"turn": "0.5"},
        {"turn": True},
        {"control": VehicleStatus(Control.LOST, "gone", armed="perhaps")},  # type: ignore[arg-type]
    ],
)
def test_a_message_of_other_contents_is_refused(
    change: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle, numbers = next(cycles()), FlightMessages._numbers  # which take none but numbers
    monkeypatch.setattr(FlightMessages, "_numbers", lambda messages, changed: numbers(messages, cycle))
    with FlightLog(tmp_path / "f.mcap", contract(), GOAL, clock=lambda: START) as log:
        log.write(replace(cycle, **change))
    with pytest.raises(UavrlError, match="holds a message that no flight has written"):
        list(LoggedFlight(log.path))
