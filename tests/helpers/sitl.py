"""A simulated vehicle whose episode is a script, and the companion's side of its link."""

from __future__ import annotations

import math
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from tests.helpers.autopilot_peer import free_port
from uavrl.sitl.live import PIECE, PIECES, Motion
from uavrl.sitl.sitl import Sitl
from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import Control
from uavrl_onboard.lidar.vlp16 import AZIMUTH_STEPS, firing_directions

DIRECTIONS = firing_directions()


class Scripted:
    """An episode that flies exactly what it is told, in a room whose walls are as far as its age."""

    def __init__(self, ends_after: float = math.inf, slow: float = 0.0) -> None:
        self.place, self.yaw, self.age, self.goal = np.array([0.0, 0.0, 3.5]), 0.0, 0.0, np.array([10.0, 0.0, 2.5])
        self.points = np.array(DIRECTIONS, dtype=np.float32)
        self.outcome: str | None = None
        self.stopped, self.flown = False, []  # type: tuple[bool, list[Any]]
        self._ends, self._slow, self._pieces = ends_after, slow, 0

    @property
    def motion(self) -> Motion:
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Motion(self.place.copy(), np.zeros(3), turn, np.zeros(3))

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.goal - self.place))

    def stop_motors(self) -> None:
        self.stopped = True

    def _fly(self, velocity: np.ndarray, yaw_rate: float, seconds: float) -> None:
        self.place, self.yaw = self.place + seconds * velocity, self.yaw + seconds * yaw_rate
        self.age += seconds
        self.flown.append((*velocity, yaw_rate))
        if self.age >= self._ends and self.outcome is None:
            self.outcome = "success"

    def piece(self, velocity: np.ndarray, yaw_rate: float) -> slice:
        time.sleep(self._slow)
        self._fly(velocity, yaw_rate, PIECE)
        now, self._pieces = self._pieces % PIECES, self._pieces + 1
        cycles = [round(AZIMUTH_STEPS / 2 * piece / PIECES) * 32 for piece in (now, now + 1)]
        self.points[slice(*cycles)] = (1.0 + self.age) * DIRECTIONS[slice(*cycles)]
        return slice(*cycles)

    def step(self, command: np.ndarray) -> None:
        self._fly(command[:3], command[3], 0.1)
        self.points = ((1.0 + self.age) * DIRECTIONS).astype(np.float32)


class Ground:
    """What a companion has: the LiDAR's port and an Autopilot.

    A thread reads the port while the vehicle flies: many a Linux keeps no more than a quarter of a second for it.
    """

    def __init__(self) -> None:
        self.port, self.lidar = free_port(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.lidar.bind(("127.0.0.1", 0))
        self.lidar.setblocking(False)
        self.addresses = (f"udp://127.0.0.1:{self.lidar.getsockname()[1]}", f"udp://127.0.0.1:{self.port}")
        self._read, self._reading, self._closed = list[bytes](), threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._closed.is_set():
            if select.select([self.lidar], [], [], 0.05)[0]:
                self._read_all()

    def _read_all(self) -> None:
        with self._reading, suppress(BlockingIOError):
            while True:
                self._read.append(self.lidar.recv(2048))

    def packets(self) -> list[bytes]:
        """What has come since the last call."""
        self._read_all()
        with self._reading:
            read, self._read = self._read, []
        return read

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self.lidar.close()


def fly(ground: Ground, seconds: float, setpoint: tuple[float, ...], until: Callable[[], bool] = lambda: False) -> Any:
    """Our own link flies with one set-point, ten times a second; returns the states of control that it was in."""
    seen: list[tuple[float, Control]] = []
    begun = time.monotonic()
    with Autopilot(f"udp://127.0.0.1:{ground.port}", set_mode=True, arm=True) as link:
        while (now := time.monotonic()) < begun + seconds and not until():
            link.receive(now)
            link.send(setpoint, now)
            control = link.status(now).control
            if not seen or seen[-1][1] is not control:
                seen.append((now - begun, control))
            time.sleep(0.05)
    return [control for _, control in seen]


def running(sitl: Sitl) -> threading.Thread:
    thread = threading.Thread(target=sitl.run, daemon=True)
    thread.start()
    return thread
