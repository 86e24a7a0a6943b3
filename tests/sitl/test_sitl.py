"""The loop of a simulated vehicle, with an episode by script: what is sent when, and how it ends."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from tests.helpers.autopilot_peer import garbage
from tests.helpers.sitl import Ground, Scripted
from uavrl.errors import UavrlError
from uavrl.sitl.faults import Faults
from uavrl.sitl.live import PIECE
from uavrl.sitl.sitl import Sitl
from uavrl_onboard.lidar.packets import PACKET, decode_vlp16


@pytest.fixture
def ground() -> Iterator[Ground]:
    made = Ground()
    with closing(made):
        yield made


def test_the_sensor_turns_on_and_on_and_each_packet_is_of_what_was_seen_at_its_time(ground: Ground) -> None:
    episode = Scripted()
    sitl = Sitl(episode, *ground.addresses, speed=4.0, patience=0.5)  # type: ignore[arg-type]
    with pytest.raises(UavrlError, match=r"No companion took control within 0.5 s: the vehicle is in AUTO\.LOITER"):
        sitl.run()
    packets = ground.packets()
    read = np.frombuffer(b"".join(packets), PACKET)
    azimuth = read["blocks"]["azimuth"].astype(np.int64).ravel()
    assert set(np.diff(azimuth) % 36_000) <= {39, 40, 49} and (np.diff(azimuth) < 0).sum() == len(packets) * 12 // 904
    times = read["time"].astype(np.int64)
    assert len(times) > 4 * 75 and set(np.diff(times)) <= {1327, 1328, 1352}  # 1808 firings are 25 µs short of a turn
    assert times[226] == 300_000 and azimuth[226 * 12] == 0  # three turns
    for number in (0, 30, 70):  # of the first turn: the wall's distance was 1 m and the age
        ranges = np.linalg.norm(decode_vlp16([packets[number]]), axis=1)
        age = (number + 1) * 1.327e-3
        assert age - 0.001 <= ranges.mean() - 1.0 <= age + PIECE + 0.002
    assert all(row == (0.0, 0.0, 0.0, 0.0) for row in episode.flown)
    assert sitl.result.outcome == "stopped" and sitl.result.setpoints == 0


def test_in_lockstep_a_companion_that_never_comes_is_told(ground: Ground) -> None:
    sitl = Sitl(Scripted(), *ground.addresses, speed="lockstep", patience=0.3)  # type: ignore[arg-type]
    with pytest.raises(UavrlError, match=r"No set-point was obeyed for 0.3 s: .* obeyed in OFFBOARD"):
        sitl.run()


def test_what_is_too_slow_says_so_once(ground: Ground, caplog: pytest.LogCaptureFixture) -> None:
    sitl = Sitl(Scripted(slow=0.02), *ground.addresses, speed=4.0, patience=0.5)  # type: ignore[arg-type]
    with pytest.raises(
        UavrlError, match=r"No companion .* in OFFBOARD\. Its clock went slower than real time, .* load"
    ):
        sitl.run()
    assert sum("cannot hold speed=4" in record.getMessage() for record in caplog.records) == 1
    assert 0.0 < sitl.result.rate <= PIECE / 4.0 / 0.02 + 0.01  # what is behind at the end is not held either
    assert len(ground.packets()) >= 0.9 * len(sitl._lateness) > 100  # it is late, and sends all the same


def test_noise_on_its_port_does_no_harm(ground: Ground) -> None:
    sitl, rng = Sitl(Scripted(), *ground.addresses, patience=0.2), random.Random(0)  # type: ignore[arg-type]

    class Sender:
        messages = common.MAVLink(None)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(500):
            stranger.sendto(garbage(Sender, rng), ("127.0.0.1", sitl._ports.number))  # type: ignore[arg-type]
    with pytest.raises(UavrlError, match="No companion"):
        sitl.run()
    assert len(ground.packets()) > 76 and sitl.result.modes == [(0.0, "AUTO.LOITER", "start")]


def test_an_address_that_is_none_is_told() -> None:
    with pytest.raises(UavrlError, match=r"udp://no\.such\.host\.invalid:2368 cannot be sent to"):
        Sitl(Scripted(), "udp://no.such.host.invalid:2368")  # type: ignore[arg-type]


def test_faults_are_on_the_way(ground: Ground) -> None:
    sitl = Sitl(Scripted(), *ground.addresses, speed=4.0, patience=0.4, faults=Faults(lose=0.5, product=33))  # type: ignore[arg-type]
    with pytest.raises(UavrlError):
        sitl.run()
    packets = ground.packets()
    assert {packet[-1] for packet in packets} == {33} and len(packets) == pytest.approx(4 * 38, rel=0.4)
