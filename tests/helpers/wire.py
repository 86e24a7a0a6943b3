"""A vehicle of the simulator in lockstep, which a flight knows by packets and MAVLink alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.autopilot_peer import free_port
from uavrl.sitl.live import LiveEpisode
from uavrl.sitl.ports import SitlPorts
from uavrl.sitl.setpoints import read_setpoint
from uavrl.sitl.simulated_autopilot import SimulatedAutopilot
from uavrl.sitl.telemetry import Telemetry
from uavrl_onboard.autopilot.mavlink import Autopilot, mavlink
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.lidar.packets import encode_scan
from uavrl_onboard.lidar.scans import ScanAssembler
from uavrl_onboard.policy.policy import Policy


class Wire:
    """A vehicle in lockstep, of which a flight knows what packets and messages say."""

    def __init__(self, folder: Path, env: Any, task: int, **stages: Any) -> None:
        self.episode, messages = LiveEpisode(env.base_env, task), mavlink()
        self.pilot = SimulatedAutopilot(messages, "px4")
        self.telemetry, port = Telemetry(messages, self.pilot), free_port()
        self.ports = SitlPorts(messages, f"udp://127.0.0.1:{port}", 1)
        self.link, self.assembler, self.now = Autopilot(f"udp://127.0.0.1:{port}"), ScanAssembler("VLP16"), 50.0
        self.policy, self.read = Policy(folder), list[np.ndarray]()
        inner = self.policy.state

        def read(*seen: Any) -> np.ndarray:
            self.read.append(inner(*seen))
            return self.read[-1]

        self.policy.state = read  # type: ignore[assignment]
        goal = [float(each) for each in self.episode.goal]
        self.flight = Flight(self.policy, goal, self.link, SafetyLayer(), radius=0.01, **stages)

    def cycle(self, points: np.ndarray) -> FlightCycle:
        """A tenth of a second later, with a scan."""
        self.now += 0.1
        self.ports.send_messages(self.telemetry.due(self.now, self.episode.motion))
        self.link.receive(self.now)
        scans = [self.assembler.push(self.now, packet) for packet in encode_scan(points, self.now)]
        return self.flight.step(self.now, next(scan for scan in scans if scan is not None))

    def hand_over(self, points: np.ndarray) -> None:
        """The pilot hovers, and then lets the flight fly."""
        for _ in range(12):
            self.cycle(points)
        self.pilot.mode = self.pilot.dialect.ours
        self.telemetry.request(0)  # which the next heartbeat tells

    def command(self) -> np.ndarray:
        """What the vehicle is told to fly."""
        motion = self.episode.motion
        told = [each for each in self.ports.heard() if each.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        return read_setpoint(told[-1], motion.yaw).command(motion.position, motion.yaw)

    def close(self) -> None:
        """Gives its ports back."""
        self.link.close()
        self.ports.close()
