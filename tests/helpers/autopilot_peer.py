"""An autopilot by script: it speaks and hears MAVLink over loopback, and flies nothing."""

from __future__ import annotations

import random
import socket
from typing import Any, Self

from pymavlink.dialects.v20 import common

from uavrl_onboard.autopilot.mavlink import Autopilot
from uavrl_onboard.autopilot.vehicle_state import VehicleStatus

PX4, ARDUPILOT, QUADROTOR, ARMED, CUSTOM = 12, 3, 2, 128, 1
OFFBOARD, POSCTL, GUIDED, LOITER = 6 << 16, 3 << 16, 4, 5


def free_port() -> int:
    """A port of this machine that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


class Peer:
    """An autopilot's side of the link, and ours, whose time runs only when told.

    Args:
        firmware: its MAV_AUTOPILOT.
        mode: its ``custom_mode``.
        options: of our side.
    """

    def __init__(self, firmware: int = PX4, mode: int = POSCTL, *, system: int = 1, **options: Any) -> None:
        self.firmware, self.mode, self.armed, self.type = firmware, mode, True, QUADROTOR
        self.time, self.answers = 50.0, True
        self.north_east_down, self.attitude = [0.0, 0.0, -3.5, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.port = free_port()
        self.ours = Autopilot(f"udp://127.0.0.1:{self.port}", **options)
        self.received: list[Any] = []
        self.open(system)

    def open(self, system: int = 1) -> None:
        """Starts, or starts anew from another port."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.messages, self._parser = common.MAVLink(self, system, 1), common.MAVLink(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.ours.close()
        self._socket.close()

    def write(self, data: bytes) -> None:
        """Sends bytes to our side; pymavlink calls it."""
        self._socket.sendto(data, ("127.0.0.1", self.port))

    def beat(self) -> None:
        """Sends a heartbeat."""
        base_mode = CUSTOM | (ARMED if self.armed else 0)
        self.messages.heartbeat_send(self.type, self.firmware, base_mode, self.mode, 4)

    def tell(self) -> None:
        """Sends position and attitude."""
        boot_ms = int(self.time * 1000)
        self.messages.local_position_ned_send(boot_ms, *self.north_east_down)
        self.messages.attitude_send(boot_ms, *self.attitude, 0.0, 0.0, 0.0)

    def packets(self) -> list[bytes]:
        """What our side has sent since it was last asked."""
        found = []
        while True:
            try:
                found.append(self._socket.recv(65535))
            except BlockingIOError:
                return found

    def hear(self) -> list[Any]:
        """The same as messages, kept in ``received`` too."""
        heard = [message for packet in self.packets() for message in self._parser.parse_buffer(packet) or []]
        self.received += heard
        return heard

    def step(self, setpoint: tuple[float, ...] | None = (0.0, 0.0, 0.0, 0.0), *, speaks: bool = True) -> VehicleStatus:
        """A tenth of a second: the peer speaks, our side reads and sends, the peer hears."""
        self.time += 0.1
        if speaks:
            if round(self.time * 10) % 10 == 0:
                self.beat()
            self.tell()
        self.ours.receive(self.time)
        self.ours.send(setpoint, self.time)
        self.hear()
        return self.ours.status(self.time)

    def steps(
        self, count: int, setpoint: tuple[float, ...] | None = (0.0, 0.0, 0.0, 0.0), **how: bool
    ) -> VehicleStatus:
        """Several of them."""
        for _ in range(count):
            status = self.step(setpoint, **how)
        return status

    def commands(self, number: int) -> list[Any]:
        """All COMMAND_LONG of a kind that were received."""
        return [m for m in self.received if m.get_type() == "COMMAND_LONG" and m.command == number]

    def setpoints(self) -> list[Any]:
        """All set-points that were received."""
        return [m for m in self.received if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def garbage(peer: Peer, rng: random.Random) -> bytes:
    """Random bytes, bytes that begin like a message, or a message with some bytes changed."""
    kind = rng.randrange(3)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 400))
    if kind == 1:
        return bytes([rng.choice([0xFD, 0xFE])]) + rng.randbytes(rng.randrange(300))
    whole = bytearray(peer.messages.attitude_encode(1, *[0.0] * 6).pack(peer.messages))
    for _ in range(rng.randrange(1, 5)):
        whole[rng.randrange(len(whole))] = rng.randrange(256)
    return bytes(whole[: rng.randrange(1, len(whole) + 1)])
