"""Random bytes on both ports of a flight: it flies on, and keeps nothing of them."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
import tracemalloc
from contextlib import closing
from types import SimpleNamespace

import numpy as np

from tests.helpers.measured import measured
from tests.helpers.ports import free_ports
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.flight.loop import Flight, fly
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.udp_scans import UdpScans
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.vehicle import Vehicle

pytestmark = measured

SCANS = int(os.environ.get("UAVRL_NOISE_SCANS", "30"))  # among the noise, however slow the machine; 600 were tried
WITHIN = 300.0 + SCANS  # seconds
KEPT = 400_000  # bytes; a scan of 28,928 points has 350,000


class Straight:
    """Answers with one action whatever comes."""

    def __init__(self) -> None:
        cloud = SimpleNamespace(lidar=None)
        self.contract = SimpleNamespace(rate_hz=10.0, vehicle=Vehicle(), guard_settings=GuardSettings(), cloud=cloud)
        self.cells, self.last_action = None, np.zeros(4)

    def reset(self) -> None:
        pass

    def __call__(self, *_: object) -> np.ndarray:
        return np.array([1.0, 0.0, 0.0, 0.0])


def noisy(ports: tuple[int, int], ended: threading.Event) -> None:
    """A sensor's packets and, between them, thousands of others a second, of any length, and halves of packets."""
    draw = random.Random(0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while not ended.is_set():
            for packet in encode_scan(3.0 * firing_directions(), stamp=time.monotonic()):
                sender.sendto(packet, ("127.0.0.1", ports[0]))
                for port in ports:
                    sender.sendto(b"\xfd" + draw.randbytes(draw.randrange(300)), ("127.0.0.1", port))
                    sender.sendto(
                        draw.randbytes(draw.choice([1206, 512, 1, draw.randrange(1, 1500)])), ("127.0.0.1", port)
                    )
                sender.sendto(packet[: draw.randrange(1206)], ("127.0.0.1", ports[0]))
                time.sleep(0.0005)


def test_random_bytes_on_both_ports() -> None:
    ports, ended = free_ports(), threading.Event()
    sensor = threading.Thread(target=noisy, args=(ports, ended))
    lidar, autopilot = (f"udp://127.0.0.1:{port}" for port in ports)
    scans, kept, begun = 0, list[int](), time.monotonic()
    tracemalloc.start()
    try:
        with closing(UdpScans(lidar, "VLP16")) as feed, Autopilot(autopilot) as link:
            sensor.start()
            for cycle in fly(Flight(Straight(), (9.0, 0.0, 2.5), link, SafetyLayer()), feed, link):  # type: ignore[arg-type]
                scans += cycle.scan is not None
                assert cycle.status.setpoint is None and cycle.control.control.value == "waiting"
                kept.append(tracemalloc.get_traced_memory()[0])
                if scans >= SCANS:
                    break
                assert time.monotonic() - begun < WITHIN, f"{scans} scans of {SCANS} came, beside {feed.skipped}"
            skipped = feed.skipped
    finally:
        ended.set()
        sensor.join()
        tracemalloc.stop()
    assert skipped.other_size > 10 * SCANS
    middle = len(kept) // 2
    assert min(kept[middle:]) - min(kept[len(kept) // 10 : middle]) < KEPT
