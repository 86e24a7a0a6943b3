"""The link to an autopilot, against a scripted peer over loopback: bytes, signs, modes, and what goes wrong."""

from __future__ import annotations

import math
import random
import sys

import pytest
from tests.helpers.autopilot_peer import ARDUPILOT, GUIDED, LOITER, OFFBOARD, POSCTL, PX4, Peer, garbage

from uavrl_onboard.autopilot.frames import to_goal
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.safety import Cycle, SafetyLayer, SafetyState

SET_MODE, ARM, SET_INTERVAL = 176, 400, 511

# Composed with struct and a bitwise CRC-16/MCRF4XX from MAVLink's guide and its common.xml, not with this code:
# forward 1.5, left 0.5, up -0.25 m/s, 1.25 rad/s to the left, at 12.5 s, as the first message.
LITERAL = bytes.fromhex(
    "fd 35 00 00 00 01 bf 54 00 00"  # magic, 53 bytes, flags, number, from system 1, component 191, message 84
    "d4 30 00 00"  # time_boot_ms 12,500
    "00 00 00 00 00 00 00 00 00 00 00 00"  # x, y, z
    "00 00 c0 3f 00 00 00 bf 00 00 80 3e"  # vx 1.5, vy -0.5, vz 0.25
    "00 00 00 00 00 00 00 00 00 00 00 00"  # afx, afy, afz
    "00 00 00 00 00 00 a0 bf"  # yaw, yaw_rate -1.25
    "c7 05 01 01 08"  # type_mask 1479, to system 1, component 1, MAV_FRAME_BODY_NED
    "67 a4"  # checksum
)


def test_the_bytes_of_one_setpoint() -> None:
    with Peer() as peer:
        peer.beat()
        peer.ours.receive(12.5)
        peer.packets()
        peer.ours.send((1.5, 0.5, -0.25, 1.25), 12.5)
        assert LITERAL in peer.packets()


def test_the_fields_of_one_setpoint() -> None:
    with Peer(system=7) as peer:
        peer.beat()
        peer.step((2.0, -1.0, 0.5, -0.25))
        (setpoint,) = peer.setpoints()
        assert (setpoint.target_system, setpoint.target_component) == (7, 1)
        assert (setpoint.vx, setpoint.vy, setpoint.vz, setpoint.yaw_rate) == (2.0, 1.0, -0.5, 0.25)
        assert (setpoint.coordinate_frame, setpoint.type_mask) == (8, 0b010111000111)
        assert (setpoint.get_srcSystem(), setpoint.get_srcComponent()) == (7, 191), "of the vehicle's system"


def test_pose_and_goal_in_our_axes() -> None:
    with Peer() as peer:
        peer.north_east_down, peer.attitude = [10.0, 2.0, -3.5, 1.0, -0.5, 0.25], [0.1, -0.1, math.pi / 2]
        peer.beat()
        assert peer.ours.pose() is None
        peer.step()
        pose = peer.ours.pose()
        assert pose is not None
        assert pose.position == (2.0, 10.0, 3.5)
        assert pose.velocity == (-0.5, 1.0, -0.25)
        assert (pose.yaw, pose.stamp) == (pytest.approx(0.0, abs=1e-6), peer.time)  # it faces east
        assert (pose.roll, pose.pitch) == pytest.approx((0.1, 0.1))  # its left side up, its nose down
        read = to_goal(pose, (2.0, 15.0, 3.5))  # 5 m north of it
        assert read["heading_deg"] == pytest.approx(90.0, abs=1e-4)
        assert read["elevation_deg"] == 0.0
        assert (read["altitude"], read["distance"]) == (3.5, 5.0)


@pytest.mark.parametrize(("firmware", "other", "ours"), [(PX4, POSCTL, OFFBOARD), (ARDUPILOT, LOITER, GUIDED)])
def test_modes_of_both_dialects(firmware: int, other: int, ours: int) -> None:
    with Peer(firmware, other) as peer:
        assert peer.ours.status(peer.time).control is Control.WAITING
        assert peer.steps(10).control is Control.OTHER_MODE
        peer.mode, peer.armed = ours, False
        assert peer.steps(10).control is Control.DISARMED
        peer.armed = True
        status = peer.steps(10)
        assert status.control is Control.IN_CONTROL
        assert (status.firmware, status.mode) == (("PX4", "OFFBOARD") if firmware == PX4 else ("ArduPilot", "GUIDED"))
        peer.mode = other
        status = peer.steps(10)
        assert status.control is Control.TAKEN_OVER
        assert status.sentence == (
            "PX4 has left OFFBOARD for POSCTL" if firmware == PX4 else "ArduPilot has left GUIDED for LOITER"
        )
        peer.mode = ours
        assert peer.steps(10).control is Control.IN_CONTROL


def test_it_neither_arms_nor_changes_the_mode_unless_told_to() -> None:
    with Peer() as peer:
        peer.armed = False
        peer.steps(60)
        peer.mode = OFFBOARD
        peer.steps(30)
        assert not peer.commands(SET_MODE) + peer.commands(ARM)
        assert len(peer.setpoints()) > 80


@pytest.mark.parametrize(
    ("firmware", "other", "ours", "asked"), [(PX4, POSCTL, OFFBOARD, (1, 6, 0)), (ARDUPILOT, LOITER, GUIDED, (1, 4, 0))]
)
def test_told_to_it_asks_after_a_second_of_setpoints(
    firmware: int, other: int, ours: int, asked: tuple[float, ...]
) -> None:
    with Peer(firmware, other, set_mode=True, arm=True) as peer:
        peer.armed = False
        peer.steps(20, None)
        assert not peer.commands(SET_MODE)
        peer.steps(10)
        assert not peer.commands(SET_MODE)
        peer.step()
        (request,) = peer.commands(SET_MODE)
        assert (request.param1, request.param2, request.param3) == asked
        assert (request.target_system, request.target_component) == (1, 1)
        assert not peer.commands(ARM)
        peer.messages.command_ack_send(SET_MODE, 0)
        peer.mode = ours
        peer.steps(12)
        assert peer.ours.answer == "MAV_CMD_DO_SET_MODE: MAV_RESULT_ACCEPTED"
        assert [request.param1 for request in peer.commands(ARM)] == [1.0]
        peer.armed = True
        peer.steps(12)
        peer.armed = False  # the pilot has disarmed
        peer.steps(30)
        assert (len(peer.commands(SET_MODE)), len(peer.commands(ARM))) == (1, 1)


def test_a_mode_that_was_taken_away_is_not_asked_for_again() -> None:
    with Peer(set_mode=True) as peer:
        peer.steps(20)
        peer.mode = OFFBOARD
        peer.steps(10)
        peer.mode = POSCTL
        before = len(peer.commands(SET_MODE))
        assert peer.steps(50).control is Control.TAKEN_OVER
        assert len(peer.commands(SET_MODE)) == before


def test_it_asks_five_times_and_no_more() -> None:
    with Peer(set_mode=True) as peer:
        peer.steps(20)
        peer.messages.command_ack_send(SET_MODE, 2)
        peer.steps(90)
        assert len(peer.commands(SET_MODE)) == 5
        assert peer.ours.answer == "MAV_CMD_DO_SET_MODE: MAV_RESULT_DENIED"


def test_a_mode_that_was_granted_and_taken_away_before_a_heartbeat_told_is_not_asked_for_again() -> None:
    with Peer(set_mode=True) as peer:
        peer.steps(20)
        peer.messages.command_ack_send(SET_MODE, 0)
        before = len(peer.commands(SET_MODE))
        assert before > 0
        assert peer.steps(50).control is Control.OTHER_MODE
        assert len(peer.commands(SET_MODE)) == before


def test_a_broken_stream_begins_anew() -> None:
    with Peer(set_mode=True) as peer:
        peer.beat()
        for _ in range(10):
            peer.steps(8)
            peer.step(None)
        assert not peer.commands(SET_MODE)


def test_heartbeats_go_out_and_positions_are_asked_for_until_they_come() -> None:
    with Peer() as peer:
        for _ in range(30):
            peer.beat()
            peer.step(None, speaks=False)
        beats = [message for message in peer.received if message.get_type() == "HEARTBEAT"]
        assert 3 <= len(beats) <= 4
        assert {(beat.type, beat.autopilot) for beat in beats} == {(18, 8)}
        asked = {request.param1: request.param2 for request in peer.commands(SET_INTERVAL)}
        assert asked == {30.0: 20_000.0, 32.0: 20_000.0}
        before = len(peer.commands(SET_INTERVAL))
        assert before >= 6
        peer.steps(30, None)
        assert len(peer.commands(SET_INTERVAL)) == before


def test_gone_and_back_from_another_port() -> None:
    with Peer(mode=OFFBOARD) as peer:
        peer.steps(10)
        status = peer.steps(40, speaks=False)
        assert status.control is Control.LOST
        assert status.sentence.startswith("no heartbeat for 4")
        pose = peer.ours.pose()
        assert pose is not None
        assert peer.time - pose.stamp > 3.0
        peer._socket.close()
        peer.open()
        assert peer.steps(12).control is Control.IN_CONTROL
        before = len(peer.setpoints())
        peer.steps(5)
        assert len(peer.setpoints()) == before + 5


def test_gone_for_good_while_sending_falls_over_nothing() -> None:
    with Peer(mode=OFFBOARD) as peer:
        peer.steps(10)
        peer._socket.close()
        for _ in range(40):
            peer.time += 0.1
            peer.ours.send((0.0, 0.0, 0.0, 0.0), peer.time)
            peer.ours.receive(peer.time)
        assert peer.ours.status(peer.time).control is Control.LOST
        peer.open()


def test_other_senders_are_not_listened_to() -> None:
    with Peer(mode=OFFBOARD) as peer, Peer() as stranger:
        peer.steps(10)
        stranger.port, stranger.north_east_down = peer.port, [99.0, 99.0, -99.0, 0.0, 0.0, 0.0]
        stranger.time = peer.time + 1.0
        stranger.beat()
        stranger.tell()
        assert peer.step().control is Control.IN_CONTROL
        pose = peer.ours.pose()
        assert pose is not None
        assert pose.position == (0.0, 0.0, 3.5)
        assert not stranger.packets()


def test_ground_stations_and_other_systems_are_no_autopilot() -> None:
    with Peer(mode=OFFBOARD, system=3) as peer:
        peer.ours.vehicle.roster.system = 4
        peer.steps(10)
        assert peer.ours.status(peer.time).control is Control.WAITING
        assert not peer.received
    with Peer() as peer:
        peer.firmware, peer.type = 8, 6  # MAV_AUTOPILOT_INVALID, a ground station
        assert peer.steps(10).control is Control.WAITING


@pytest.mark.parametrize(("firmware", "type_"), [(0, 2), (PX4, 1), (ARDUPILOT, 10)])
def test_what_is_no_multirotor_of_ours_gets_nothing(firmware: int, type_: int) -> None:
    with Peer(firmware, OFFBOARD) as peer:
        peer.type = type_
        status = peer.steps(30)
        assert status.control is Control.UNSUPPORTED
        assert not peer.received


def test_late_packets_and_a_stuck_estimator_make_no_fresh_pose() -> None:
    with Peer() as peer:
        peer.steps(10)
        stuck = peer.time
        for _ in range(5):
            peer.step(speaks=False)
            at, peer.time = peer.time, stuck
            peer.north_east_down[0] += 1.0
            peer.tell()  # the same time again
            peer.time = at
        peer.ours.receive(peer.time)
        pose = peer.ours.pose()
        assert pose is not None
        assert (pose.stamp, pose.position[1]) == (pytest.approx(stuck), 0.0)


def test_what_waited_somewhere_is_old() -> None:
    with Peer() as peer:
        peer.steps(10)
        sent = peer.time
        peer.time += 0.1
        peer.tell()
        peer.time += 0.4  # our loop hung, or the radio did
        peer.ours.receive(peer.time)
        pose = peer.ours.pose()
        assert pose is not None
        assert pose.stamp == pytest.approx(sent + 0.11)


def test_an_autopilot_that_starts_anew_is_believed() -> None:
    with Peer() as peer:
        peer.steps(10)
        peer.messages.local_position_ned_send(100, 7.0, 0.0, -1.0, 0.0, 0.0, 0.0)
        peer.messages.attitude_send(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        peer.ours.receive(peer.time + 1.0)
        pose = peer.ours.pose()
        assert pose is not None
        assert (pose.position[1], pose.stamp) == (7.0, peer.time + 1.0)


def test_a_message_may_come_in_two_packets() -> None:
    with Peer() as peer:
        peer.steps(10)
        message = peer.messages.local_position_ned_encode(int(peer.time * 1000) + 100, 5.0, 0.0, -3.5, 0.0, 0.0, 0.0)
        packed = message.pack(peer.messages)
        peer.write(packed[:20])
        peer.write(packed[20:])
        peer.ours.receive(peer.time + 0.1)
        pose = peer.ours.pose()
        assert pose is not None
        assert pose.position[1] == 5.0


def test_random_bytes_do_no_harm_and_take_no_memory() -> None:
    rng, pending = random.Random(0), 0
    with Peer(mode=OFFBOARD) as peer:
        peer.steps(10)
        for _ in range(30):
            for _ in range(10):
                peer.write(garbage(peer, rng))
            status = peer.step()
            pending = max(pending, len(peer.ours._parser.buf))
            pose = peer.ours.pose()
            assert pose is not None
            assert pose.stamp == peer.time
        assert status.control is Control.IN_CONTROL
        assert pending < 300  # no message is longer
        assert len(peer.setpoints()) == 31  # one each cycle from the first heartbeat on


def test_numbers_that_are_none_reach_the_safety_layer_and_stop_there() -> None:
    layer = SafetyLayer()
    with Peer(mode=OFFBOARD) as peer:
        for tick in range(35):
            if tick == 25:
                peer.north_east_down[1] = math.nan
            status, pose = peer.ours.status(peer.time), peer.ours.pose()
            in_control = status.control is Control.IN_CONTROL
            place = (pose.stamp, pose.position, pose.yaw) if pose else (None, None, None)
            record = layer.step(Cycle(peer.time, (1.0, 0.0, 0.0, 0.0), peer.time, *place, in_control))
            peer.step(record.setpoint)
            if tick == 25:
                assert record.state is SafetyState.FLYING
        assert str(record.reason) == "pose_not_finite"
        sent = [setpoint.vx for setpoint in peer.setpoints()]
        assert sent[-5:] == [0.0] * 5
        assert record.setpoint is None


def test_a_roll_that_is_none_stops_no_flight() -> None:
    layer = SafetyLayer()
    with Peer(mode=OFFBOARD) as peer:
        for tick in range(35):
            if tick == 25:
                peer.attitude[:2] = [math.nan, math.inf]
            status, pose = peer.ours.status(peer.time), peer.ours.pose()
            in_control = status.control is Control.IN_CONTROL
            place = (pose.stamp, pose.position, pose.yaw) if pose else (None, None, None)
            record = layer.step(Cycle(peer.time, (1.0, 0.0, 0.0, 0.0), peer.time, *place, in_control))
            peer.step(record.setpoint)
        assert record.state is SafetyState.FLYING and record.setpoint == (1.0, 0.0, 0.0, 0.0)
        assert pose is not None and math.isnan(pose.roll) and math.isinf(pose.pitch)
        assert pose.rotation == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))  # north, level


@pytest.mark.parametrize("wrong", [(0.0, 0.0, math.nan, 0.0), (1.0, 2.0)])
def test_a_setpoint_that_is_none_is_not_sent(wrong: tuple[float, ...]) -> None:
    with Peer() as peer:
        peer.steps(3)
        peer.received.clear()
        with pytest.raises(UavrlError, match="four finite numbers"):
            peer.ours.send(wrong, peer.time)
        assert not peer.hear()


def test_a_port_that_is_taken_is_named() -> None:
    with Peer() as peer, pytest.raises(UavrlError, match=f"udp://127.0.0.1:{peer.port} cannot be listened to"):
        Autopilot(f"udp://127.0.0.1:{peer.port}")


def test_without_pymavlink_one_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.common", None)
    with pytest.raises(UavrlError, match=r"pymavlink: pip install 'uavrl-onboard\[mavlink\]'"):
        Autopilot()
