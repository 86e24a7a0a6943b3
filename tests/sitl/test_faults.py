"""What is lost, late or silent on purpose."""

from __future__ import annotations

import pytest

from uavrl.errors import UavrlError
from uavrl.sitl.faults import Faults

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
    told = [(bool(faults.of_lidar(PACKETS[:1], at)), faults.hides_pose(at)) for at in (None, 0.9, 1.0, 2.0, 3.5, 4.0)]
    assert told == [(True, False), (True, False), (False, False), (True, False), (True, True), (True, False)]


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
    ],
)
def test_what_is_none(wrong: dict[str, float], says: str) -> None:
    with pytest.raises(UavrlError, match=says):
        Faults(**wrong)  # type: ignore[arg-type]
