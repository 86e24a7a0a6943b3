"""Who the vehicle is on a link: not a camera, not another vehicle, and only with its signature where there is one."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common
from tests.helpers.autopilot_peer import ARDUPILOT, OFFBOARD, POSCTL, PX4, Peer

from uavrl_onboard.autopilot.signing import read_key
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.errors import UavrlError

KEY = b"k" * 32
GIMBAL, CAMERA, RECEIVER, COMPANION = (26, 8), (30, 0), (27, 8), (18, 0)  # MAV_TYPE, MAV_AUTOPILOT


def beat_of(peer: Peer, component: int, type_: int, autopilot: int, system: int = 1, mode: int = 0) -> None:
    """A heartbeat of another component on the peer's address."""
    common.MAVLink(peer, system, component).heartbeat_send(type_, autopilot, 128 | 1, mode, 4)


@pytest.mark.parametrize("system", [None, 1])
@pytest.mark.parametrize(
    ("component", "kind"), [(100, CAMERA), (154, GIMBAL), (156, RECEIVER), (191, COMPANION), (191, (2, PX4))]
)
def test_no_other_component_is_the_vehicle(component: int, kind: tuple[int, int], system: int | None) -> None:
    with Peer(mode=OFFBOARD, system=1) as peer:
        peer.ours.vehicle.roster.system = system
        beat_of(peer, component, *kind)
        status = peer.step(speaks=False)
        assert status.control is Control.WAITING and f"(1/{component})" in status.sentence
        for _ in range(30):
            beat_of(peer, component, *kind)
            status = peer.step()
        assert status.control is Control.IN_CONTROL and peer.ours.vehicle.source == (1, 1)
        assert {setpoint.target_component for setpoint in peer.setpoints()} == {1}


def test_a_multirotor_comes_before_a_rover_that_was_heard_first() -> None:
    with Peer(mode=OFFBOARD) as peer, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:

        class Rover:
            def write(self, data: bytes) -> None:
                other.sendto(data, ("127.0.0.1", peer.port))

        rover = common.MAVLink(Rover(), 9, 1)
        rover.heartbeat_send(10, ARDUPILOT, 129, 4, 4)
        assert peer.step(speaks=False).control is Control.UNSUPPORTED
        assert peer.steps(12).control is Control.IN_CONTROL
        rover.heartbeat_send(10, ARDUPILOT, 129, 4, 4)
        assert peer.steps(12).control is Control.IN_CONTROL and peer.ours.vehicle.source == (1, 1)


def test_the_system_that_is_missing_is_named_and_who_is_there() -> None:
    with Peer(system=3) as peer:
        peer.ours.vehicle.roster.system = 4
        assert (
            peer.steps(10).sentence == "no autopilot of system 4 has been heard yet, only a multirotor with PX4 (3/1)"
        )


@pytest.mark.parametrize("mode", [POSCTL, OFFBOARD])
def test_of_two_vehicles_from_the_start_none_is_flown_unless_one_is_named(mode: int) -> None:
    with Peer(mode=mode, set_mode=True, arm=True) as peer:
        for tick in range(40):
            if tick % 10 == 5:
                beat_of(peer, 1, 2, PX4, system=2, mode=mode)
            status = peer.step(speaks=True)
        assert status.control is Control.AMBIGUOUS
        assert status.sentence == (
            "2 vehicles send on this link, systems 1 and 2: give system=1 or system=2. Nothing is sent"
        )
        before = len(peer.received)
        peer.steps(10)
        assert len(peer.received) == before and not peer.commands(176) + peer.commands(400)
    with Peer(mode=OFFBOARD, system=2) as peer:
        peer.ours.vehicle.roster.system = 2
        for _ in range(20):
            beat_of(peer, 1, 2, PX4, system=1)
            status = peer.step()
        assert status.control is Control.IN_CONTROL
        assert {setpoint.target_system for setpoint in peer.setpoints()} == {2}


def test_a_vehicle_that_comes_later_is_told_and_never_flown(caplog: pytest.LogCaptureFixture) -> None:
    with Peer(mode=OFFBOARD) as peer:
        peer.steps(60)
        beat_of(peer, 1, 2, PX4, system=2)
        assert peer.steps(5).control is Control.IN_CONTROL
        for _ in range(50):
            beat_of(peer, 1, 2, PX4, system=2)
            status = peer.step(speaks=False)
        assert status.control is Control.LOST and peer.ours.vehicle.source == (1, 1)
    assert caplog.text.count("2 vehicles send on this link, systems 1 and 2: give system=1 or system=2.") == 1


def test_another_address_that_speaks_for_the_vehicle_is_told(caplog: pytest.LogCaptureFixture) -> None:
    with Peer(mode=OFFBOARD) as peer, Peer() as stranger:
        peer.steps(10)
        stranger.port, stranger.time = peer.port, peer.time
        stranger.beat()
        assert peer.step().control is Control.IN_CONTROL
        other = stranger._socket.getsockname()[1]
    assert f"127.0.0.1:{other} sends as system 1 as well: only 127.0.0.1:" in caplog.text


def test_an_autopilot_that_restarts_on_another_port_must_be_given_the_mode_again() -> None:
    with Peer(mode=OFFBOARD, set_mode=True) as peer:
        peer.time = 5.0
        peer.steps(40)
        resets, now = peer.ours.vehicle.resets, peer.time
        for _ in range(35):
            now += 0.1
            peer.ours.receive(now)
        assert peer.ours.status(now).control is Control.LOST
        peer._socket.close()
        peer.open()
        peer.mode, asked = POSCTL, len(peer.commands(176))

        def step(boot: float) -> Any:
            peer.beat()
            peer.messages.local_position_ned_send(int(boot * 1000), *peer.north_east_down)
            peer.messages.attitude_send(int(boot * 1000), *peer.attitude, 0.0, 0.0, 0.0)
            peer.ours.receive(now)
            peer.ours.send((0.0, 0.0, 0.0, 0.0), now)
            peer.hear()
            return peer.ours.status(now)

        for tick in range(20):
            now += 0.1
            status = step(3.0 + 0.1 * tick)  # its clock has gone back by less than what a late message may have
        pose = peer.ours.pose()
        assert pose is not None and now - pose.stamp < 0.2 and pose.resets == resets + 1
        assert status.control is Control.TAKEN_OVER
        assert status.sentence == "PX4 has restarted and is in POSCTL: give it OFFBOARD again"
        assert len(peer.commands(176)) == asked, "nobody but the pilot gives the mode to what has restarted"
        peer.mode = OFFBOARD
        assert step(6.0).control is Control.IN_CONTROL


def test_the_reset_counter_of_px4_s_odometry_reaches_the_pose() -> None:
    with Peer(mode=OFFBOARD) as peer:
        nothing = [0.0] * 21
        for counter in (7, 7, 8, 8):
            peer.messages.odometry_send(
                0, 1, 12, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0, 0, 0, 0, nothing, nothing, counter, 8
            )
            peer.steps(12)
        pose = peer.ours.pose()
        assert pose is not None and pose.resets == 1


def sign(peer: Peer, key: bytes = KEY) -> None:
    signing = peer.messages.signing
    signing.secret_key, signing.sign_outgoing, signing.link_id = key, True, 1
    signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)


def key_file(folder: Path, content: bytes = KEY) -> str:
    (folder / "key").write_bytes(content)
    return str(folder / "key")


def test_a_signed_link_is_explained_and_nothing_is_sent() -> None:
    with Peer(mode=OFFBOARD) as peer:
        sign(peer)
        status = peer.steps(20)
        assert status.control is Control.SIGNED and not peer.received
        assert status.sentence == (
            "PX4 signs its messages and ignores ours: give signing_key_file=, the file with the link's key. "
            "Nothing is sent"
        )


@pytest.mark.parametrize("content", [KEY, b"6b" * 32 + b"\n"])
def test_with_its_key_a_signed_link_is_flown(content: bytes, tmp_path: Path) -> None:
    with Peer(mode=OFFBOARD, signing_key_file=key_file(tmp_path, content)) as peer:
        sign(peer)
        peer._parser.signing.secret_key = KEY  # which refuses what is not signed with it
        assert peer.steps(20).control is Control.IN_CONTROL
        assert len(peer.setpoints()) > 8
        assert all(message.get_signed() for message in peer.received)


@pytest.mark.parametrize("theirs", [None, b"x" * 32])
def test_with_a_key_nothing_else_is_believed(theirs: bytes | None, tmp_path: Path) -> None:
    with Peer(mode=OFFBOARD, signing_key_file=key_file(tmp_path)) as peer:
        if theirs is not None:
            sign(peer, theirs)
        status = peer.steps(20)
        assert status.control is Control.WAITING and peer.ours.pose() is None and not peer.received
        assert status.sentence.startswith("no message bears a signature of signing_key_file=: it is another key, none")


def test_what_is_no_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UavrlError, match=r"none cannot be read \(No such file"):
        read_key(tmp_path / "none")
    for content in (b"", b"k" * 31, b"zz" * 32):
        with pytest.raises(UavrlError, match=f"holds {len(content)} bytes and is no signing key"):
            read_key(key_file(tmp_path, content))
