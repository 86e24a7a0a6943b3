"""Clocks that are set while they run: NTP, a bag that starts again, a board without a clock of its own, a restart."""

from __future__ import annotations

import logging
from collections.abc import Iterable

import pytest
from tests.helpers.autopilot_peer import Peer

from uavrl_onboard.autopilot.clock_sync import SenderClock
from uavrl_onboard.ros2.dds import Arrived
from uavrl_onboard.ros2.vehicle import Stamps

WALL = 1_790_000_000.0  # our time of day at the zero of our clock


def stamps(clock: SenderClock, heard: Iterable[tuple[float, float]]) -> list[float | None]:
    return [clock.stamp(sent, now) for sent, now in heard]


@pytest.mark.parametrize("step", [-3.0, -0.4, -9.0])
def test_a_step_back_costs_two_messages(step: float, caplog: pytest.LogCaptureFixture) -> None:
    clock = SenderClock("/odom")
    before = [(100.0 + 0.02 * k, 0.02 * k) for k in range(50)]
    after = [(100.0 + step + 0.02 * k, 0.02 * k) for k in range(50, 100)]
    assert stamps(clock, before) == pytest.approx([now for _, now in before])
    got = stamps(clock, after)
    assert got[:2] == [None, None] and got[2:] == pytest.approx([now for _, now in after[2:]])
    assert (clock.steps, clock.offset) == (1, pytest.approx(step))
    (line,) = caplog.messages
    assert line.startswith(f"The clock that stamps /odom has stepped back by {-step:.1f} s")


def test_a_step_forward_costs_none(caplog: pytest.LogCaptureFixture) -> None:
    clock = SenderClock("/odom")
    assert stamps(clock, [(100.0, 5.0), (100.1, 5.1), (WALL, 5.2), (WALL + 0.1, 5.3)]) == [5.0, 5.1, 5.2, 5.3]
    assert clock.steps == 1 and clock.offset == pytest.approx(WALL - 100.2)
    assert "has stepped forward by 1789999899.8 s" in caplog.messages[0]


@pytest.mark.parametrize("length", [2.0, 60.0])
def test_a_bag_that_starts_again_goes_on(length: float) -> None:
    clock, now = SenderClock("/points"), 0.0
    for turn in range(1, 4):
        got = stamps(clock, [(WALL + 0.1 * k, now + 0.1 * k) for k in range(round(length * 10))])
        lost = 0 if turn == 1 or length > 10.0 else 2
        assert None not in got[lost:] and got[-1] == pytest.approx(now + length - 0.1), turn
        now += length
    assert clock.steps == 2


def test_late_and_repeated_messages_are_no_step() -> None:
    clock = SenderClock("/odom")
    in_order = stamps(clock, [(10.0, 1.0), (10.5, 1.5)])
    mixed = [(10.2, 1.51), (10.3, 1.52), (10.6, 1.6), (10.4, 1.61), (10.55, 1.62), (10.7, 1.7)]  # two ways, one slower
    assert in_order == [1.0, 1.5] and stamps(clock, mixed) == [None, None, 1.6, None, None, pytest.approx(1.7)]
    assert stamps(clock, [(10.7, 1.8 + 0.1 * k) for k in range(9)]) == [None] * 9, "a publisher that repeats itself"
    assert stamps(clock, [(10.65, 3.0), (10.5, 3.1), (10.4, 3.2), (10.3, 3.3)]) == [None] * 4, "in reverse"
    burst = [(10.8, 3.9), (10.5, 4.001), (10.6, 4.002), (10.7, 4.003)]
    assert stamps(clock, burst)[1:] == [None] * 3, "what another way has held back"
    assert clock.steps == 0


def test_what_waited_is_not_a_step_forward() -> None:
    clock = SenderClock("/odom")
    assert stamps(clock, [(10.0, 1.0), (10.1, 5.0), (13.9, 5.01)]) == [1.0, pytest.approx(1.11), pytest.approx(5.01)]
    assert clock.steps == 0, "the second message waited for 3.9 s, so the third does not come too early"


def told(messages: Iterable[tuple[float, float, float]]) -> list[float | None]:
    """How old messages are, by (header's time, our time of day, our clock)."""
    seen = Stamps("/odom")
    given = [(seen.of(made, Arrived(None, made, wall, now)), now) for made, wall, now in messages]
    return [None if stamp is None else round(now - stamp, 3) for stamp, now in given]


TICKS = [0.1 * k for k in range(1, 41)]
AGE = 0.03


def test_ages_go_on_after_the_sender_s_clock_has_stepped_back() -> None:
    ages = told((WALL + t - AGE - (3.0 if t > 2 else 0.0), WALL + t, t) for t in TICKS)
    assert [age for age in ages if age is None] == [None, None]
    assert {age for age in ages if age is not None} == {AGE}


def test_ages_go_on_after_one_computer_s_clock_has_stepped() -> None:
    for step in (-3.0, 3.0):
        set_to = {t: WALL + t + (step if t > 2 else 0.0) for t in TICKS}
        ages = told((wall - AGE, wall, t) for t, wall in set_to.items())
        assert ages.count(None) == (2 if step < 0 else 0) and {age for age in ages if age is not None} == {AGE}


def test_ages_go_on_after_our_clock_alone_has_stepped() -> None:
    assert set(told((WALL + t - AGE, WALL + t + (3.0 if t > 2 else 0.0), t) for t in TICKS)) == {AGE}
    late = told((WALL + t - AGE, WALL + t + (0.0 if t > 2 else 3.0), t) for t in TICKS)
    assert late[0] == 3.0 + AGE and late[-1] == AGE, "a clock that was wrong and is set right"


def test_a_board_that_begins_in_1970_counts_from_arrival_until_its_clock_is_set() -> None:
    ages = told(((WALL if t > 2 else 0.0) + t - AGE, WALL + t, t) for t in TICKS)
    assert ages == [0.0] * 20 + [AGE] * 20


def test_what_waits_is_old_by_either_clock() -> None:
    ages = told((WALL + t - 3.0, WALL + now, now) for t in TICKS for now in [t + (0.5 if t > 2 else 0.0)])
    assert ages == [3.0] * 20 + [3.5] * 20


def test_an_autopilot_whose_boot_time_starts_again_is_heard(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    with Peer() as peer:
        peer.beat()
        for number in range(3):  # it had run for 4 s
            peer.time += 0.02
            for send in (peer.messages.local_position_ned_send, peer.messages.attitude_send):
                send(4000 + 20 * number, *([float(number)] * 6))
            peer.ours.receive(peer.time)
        for number in range(10):
            peer.time += 0.02
            for send in (peer.messages.local_position_ned_send, peer.messages.attitude_send):
                send(500 + 20 * number, *([float(number)] * 6))
            peer.ours.receive(peer.time)
        pose = peer.ours.pose()
    assert pose is not None and pose.stamp == pytest.approx(peer.time) and pose.position[0] == 9.0
    assert "the autopilot's ATTITUDE has stepped back by 3.6 s" in " ".join(caplog.messages)


def test_two_senders_as_one_are_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """Two vehicles of one system id behind one router, whose clocks began 500 s apart."""
    clock = SenderClock("the autopilot's ATTITUDE")
    stamps(clock, [(100.0 + 0.02 * k + 500.0 * (k % 2), 0.02 * k) for k in range(500)])
    assert len(caplog.messages) == 4 and clock.steps > 100
    assert caplog.messages[-1] == (
        "The stamps of the autopilot's ATTITUDE step back and forth: two senders are taken for one. Turn one off, or "
        "give each a number or a topic of its own."
    )


def test_a_clock_that_steps_now_and_then_is_told_each_time(caplog: pytest.LogCaptureFixture) -> None:
    clock = SenderClock("/odom")
    stamps(clock, [(100.0 + 0.1 * k + 3.0 * (k // 60), 0.1 * k) for k in range(600)])
    assert [
        message.startswith("The clock that stamps /odom has stepped forward by 3.0 s") for message in caplog.messages
    ]
    assert len(caplog.messages) == clock.steps == 9
