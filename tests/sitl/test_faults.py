"""What is lost, late or silent on purpose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from uavrl.errors import UavrlError
from uavrl.sitl.faults import Faults
from uavrl_onboard.lidar.packets import decode_vlp16, encode_scan
from uavrl_onboard.lidar.vlp16 import firing_directions

PACKETS = [bytes([number % 256]) * 1206 for number in range(2000)]


def test_a_share_is_lost_and_the_same_each_time() -> None:
    once, again = (Faults(lose=0.1).of_lidar(PACKETS, None) for _ in range(2))
    assert once == again and len(once) == pytest.approx(1800, abs=60)
    assert Faults().of_lidar(PACKETS, None) == PACKETS


def test_a_share_comes_after_the_next_one_and_none_is_lost() -> None:
    faults = Faults(reorder=0.2)
    arrived = [packet for first in range(0, 2000, 10) for packet in faults.of_lidar(PACKETS[first : first + 10], None)]
    assert arrived != PACKETS and 1999 <= len(arrived) <= 2000
    moved = sum(packet != there for packet, there in zip(arrived, PACKETS, strict=False))
    assert 400 < moved < 900


def test_silences_count_from_the_first_obeyed_setpoint() -> None:
    faults = Faults(lidar_silent=(1.0, 2.0), pose_silent=(3.0, 4.0))
    seen = [
        (bool(faults.of_lidar(PACKETS[:1], at)), told(faults, at) is None) for at in (None, 0.9, 1.0, 2.0, 3.5, 4.0)
    ]
    assert seen == [(True, False), (True, False), (False, False), (True, False), (True, True), (True, False)]


def test_another_product_byte() -> None:
    (packet,) = Faults(product=0x21).of_lidar(PACKETS[:1], None)
    assert packet == PACKETS[0][:-1] + b"\x21"


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"lose": 1.5}, "faults.lose must be a share"),
        ({"reorder": -0.1}, "faults.reorder must be a share"),
        ({"lidar_silent": (2.0, 1.0)}, "the earlier first"),
        ({"pose_silent": (-1.0, 1.0)}, "the earlier first"),
        ({"product": 256}, "must be a byte"),
        ({"half_scan": (2.0, 1.0)}, "faults.half_scan must be two times"),
        ({"clock_step": (-1.0, 3.0)}, "faults.clock_step must begin with a time"),
        ({"pose_rate": 0.0}, "faults.pose_rate must be above 0"),
        ({"jump": (math.inf, 0.0, 0.0)}, "faults.jump and faults.drift must be finite"),
    ],
)
def test_what_is_none(wrong: dict[str, float], says: str) -> None:
    with pytest.raises(UavrlError, match=says):
        Faults(**wrong)  # type: ignore[arg-type]


def placed(number: int = 32) -> Any:
    """LOCAL_POSITION_NED or ODOMETRY at (1, 2, -3) north, east, down, after 5 s."""
    if number == 32:
        return common.MAVLink_local_position_ned_message(5000, 1.0, 2.0, -3.0, 0.0, 0.0, 0.0)
    none = [math.nan] * 21
    return common.MAVLink_odometry_message(
        5_000_000, 1, 12, 1.0, 2.0, -3.0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, none, none, 7, 0
    )


def told(faults: Faults, since: float | None, now: float = 5.0, number: int = 32) -> Any:
    return next(iter(faults.of_telemetry([placed(number)], now, since)), None)


def test_a_position_that_jumps_to_the_east_and_back() -> None:
    faults = Faults(pose_jump=(2.0, 3.0), jump=(20.0, 5.0, 1.0))
    for number in (32, 331):
        places = [
            [each.x, each.y, each.z] for each in (told(faults, at, number=number) for at in (None, 1.9, 2.0, 3.0))
        ]
        assert places == [[1.0, 2.0, -3.0]] * 2 + [[6.0, 22.0, -4.0]] + [[1.0, 2.0, -3.0]]


def test_a_position_that_drifts_and_stays_there() -> None:
    faults = Faults(pose_drift=(2.0, 4.0), drift=(1.5, 0.0, 0.0))
    assert [told(faults, at).y for at in (1.0, 3.0, 4.0, 9.0)] == [2.0, 3.5, 5.0, 5.0]


def test_an_estimator_that_resets_counts_up() -> None:
    faults = Faults(reset=2.0)
    assert [told(faults, at, number=331).reset_counter for at in (None, 1.9, 2.0, 3.0)] == [7, 7, 8, 8]


def test_an_autopilot_whose_clock_steps() -> None:
    assert [told(Faults(clock_step=(2.0, -3.0)), at).time_boot_ms for at in (1.9, 2.0)] == [5000, 2000]
    assert told(Faults(clock_step=(2.0, 3.0)), 2.0, number=331).time_usec == 8_000_000
    assert told(Faults(clock_step=(2.0, -30.0)), 2.0).time_boot_ms == 0, "it has just started"


def test_a_pose_that_is_told_seldom() -> None:
    faults = Faults(slow_pose=(0.0, 10.0), pose_rate=5.0)
    times = [number / 50 for number in range(50)]
    assert sum(told(faults, now, now) is not None for now in times) == pytest.approx(5, abs=1)
    beat = common.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    assert len(faults.of_telemetry([beat] * 50, 0.5, 0.5)) == 50, "of all other messages nothing is missing"


def test_a_camera_beats_once_a_second() -> None:
    faults = Faults(camera=True)
    beats = [faults.camera_beats(number / 10) for number in range(31)]
    assert sum(beat is not None for beat in beats) == 4 and beats[0] == {**beats[0], "type": 30, "autopilot": 8}
    assert Faults().camera_beats(0.0) is None


def test_half_of_a_scan_and_a_second_sensor() -> None:
    packets = encode_scan(3.0 * firing_directions())
    faults = Faults(half_scan=(1.0, 2.0), second_sensor=(1.0, 2.0))
    ahead = decode_vlp16(faults.of_lidar(packets, 1.5))
    assert len(ahead) == pytest.approx(28_928 / 2, rel=0.01) and ahead[:, 0].min() > -0.1
    assert faults.of_lidar(packets, 2.0) == packets and faults.of_second_sensor(packets, 2.0) == []
    ranges = np.linalg.norm(decode_vlp16(faults.of_second_sensor(packets, 1.5)), axis=1)
    assert len(ranges) == 28_928 and np.allclose(ranges, 1.5, atol=0.003)


def test_a_scan_that_is_repeated_has_new_times() -> None:
    first, later = (encode_scan(far * firing_directions(), stamp=far) for far in (3.0, 5.0))
    faults = Faults(frozen_scan=(1.0, 2.0))
    assert faults.of_lidar(later, 0.5) == later
    assert faults.of_lidar(first, 1.0) == first
    repeated = faults.of_lidar(later, 1.1)
    assert np.allclose(np.linalg.norm(decode_vlp16(repeated), axis=1), 3.0, atol=0.003)
    assert [packet[-6:] for packet in repeated] == [packet[-6:] for packet in later]


def test_clouds_suffer_the_same_as_packets() -> None:
    def cloud(far: float) -> np.ndarray:
        return np.where(firing_directions()[:, 2:] > 0.2, np.nan, far * firing_directions()).astype(np.float32)

    def ranges(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[np.isfinite(points[:, 0])], axis=1)

    count = len(ranges(cloud(1.0)))
    (half,) = Faults(half_scan=(1.0, 2.0)).of_lidar([cloud(3.0)], 1.5)
    assert np.nanmin(half[:, 0]) >= 0.0 and len(ranges(half)) == pytest.approx(count / 2, rel=0.01)
    assert half.shape == cloud(3.0).shape
    frozen = Faults(frozen_scan=(1.0, 2.0))
    assert [
        float(ranges(frozen.of_lidar([cloud(far)], at)[0]).max()) for far, at in ((3, 1.0), (5, 1.1), (5, 2.0))
    ] == [pytest.approx(each) for each in (3.0, 3.0, 5.0)]
    ahead = np.array([[3.0, 0.0, 0.5]], np.float32)
    (turned,) = Faults(turned_scan=(0.0, 9.0), turn=90.0).of_lidar([ahead], 1.0)
    np.testing.assert_allclose(turned, [[0.0, 3.0, 0.5]], atol=1e-6)
    assert turned.dtype == np.float32
    second = Faults(second_sensor=(1.0, 2.0))
    assert ranges(second.of_second_sensor([cloud(3.0)], 1.5)[0]) == pytest.approx(1.5)
    assert second.of_second_sensor([cloud(3.0)], 2.0) == []
    clouds = [np.full((1, 3), number, np.float32) for number in range(400)]
    lost = Faults(lose=0.25).of_lidar(clouds, None)
    assert 270 < len(lost) < 330
    faults = Faults(reorder=0.3)
    arrived = [float(each[0, 0]) for one in clouds for each in faults.of_lidar([one], None)]
    assert arrived != sorted(arrived) and len(arrived) >= 399


def test_a_lidar_that_is_turned_to_the_right_sees_what_is_ahead_on_its_left() -> None:
    directions = firing_directions()
    ahead = np.where((directions[:, :1] > 0.9), 3.0 * directions, np.nan)
    seen = decode_vlp16(Faults(turned_scan=(0.0, 9.0), turn=90.0).of_lidar(encode_scan(ahead), 1.0))
    assert len(seen) > 1000 and (seen[:, 1] > 2.4).all() and np.abs(seen[:, 0]).max() < 1.5


def test_a_pose_that_stands_still_has_no_velocity_and_new_times() -> None:
    faults = Faults(frozen_pose=(1.0, 2.0))
    first = told(faults, 1.0)
    later = common.MAVLink_local_position_ned_message(6000, 9.0, 9.0, -4.0, 2.0, 1.0, 0.0)
    (stands,) = faults.of_telemetry([later], 6.0, 1.5)
    assert (stands.time_boot_ms, stands.x, stands.y, stands.z) == (6000, first.x, first.y, first.z)
    assert (stands.vx, stands.vy, stands.vz) == (0.0, 0.0, 0.0)
