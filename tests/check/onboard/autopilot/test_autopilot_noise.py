"""An autopilot's link under a minute's worth of noise."""

from __future__ import annotations

import random
import time
import tracemalloc

from tests.helpers.autopilot_peer import OFFBOARD, Peer, garbage
from tests.helpers.measured import measured
from uavrl_onboard.autopilot.vehicle_state import Control

pytestmark = measured


def test_a_minute_of_random_bytes_does_no_harm_and_takes_no_memory() -> None:
    rng, spent = random.Random(0), 0.0
    with Peer(mode=OFFBOARD) as peer:
        peer.steps(10)
        tracemalloc.start()
        try:
            for tick in range(600):
                if tick == 100:
                    before = tracemalloc.get_traced_memory()[0]
                for _ in range(10):
                    peer.write(garbage(peer, rng))
                begun = time.process_time()
                status = peer.step((0.5, 0.0, 0.0, 0.0))
                spent += time.process_time() - begun
                peer.received = peer.received[-1:]
                assert status.control is Control.IN_CONTROL
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        assert peer.received[-1].vx == 0.5
        assert grown < 50_000, grown
        assert spent < 30.0, spent  # of a minute, with tracemalloc, which makes all slower
