"""What a policy reads over packets and MAVLink is what it has read in the simulator."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.autopilot_peer import free_port
from tests.helpers.commands import VALLEY
from tests.helpers.exported import exported
from uavrl.config import compose, validate
from uavrl.deploy.autopilot import Autopilot, mavlink
from uavrl.deploy.flight import Flight
from uavrl.deploy.packets import encode_scan
from uavrl.deploy.policy import Policy
from uavrl.deploy.safety import SafetyLayer, State
from uavrl.deploy.scans import ScanAssembler
from uavrl.deploy.setpoints import read_setpoint
from uavrl.deploy.simulated_autopilot import SimulatedAutopilot
from uavrl.deploy.sitl_ports import SitlPorts
from uavrl.deploy.stages import FlightCycle
from uavrl.deploy.telemetry import Telemetry
from uavrl.envs.live import LiveEpisode
from uavrl.rollout.environment import make_env

TASK, STEPS = 1, 15


class Wire:
    """A vehicle in lockstep, of which a flight knows what packets and messages say."""

    def __init__(self, folder: Path, env: Any) -> None:
        self.episode, messages = LiveEpisode(env.base_env, TASK), mavlink()
        self.pilot = SimulatedAutopilot(messages, "px4")
        self.telemetry, port = Telemetry(messages, self.pilot), free_port()
        self.ports = SitlPorts(messages, "udp://127.0.0.1:9", f"udp://127.0.0.1:{port}", 1)
        self.link, self.assembler, self.now = Autopilot(f"udp://127.0.0.1:{port}"), ScanAssembler("VLP16"), 50.0
        self.policy, self.read = Policy(folder), list[np.ndarray]()
        inner = self.policy.state

        def read(*seen: Any) -> np.ndarray:
            self.read.append(inner(*seen))
            return self.read[-1]

        self.policy.state = read  # type: ignore[assignment]
        goal = [float(each) for each in self.episode.goal]
        self.flight = Flight(self.policy, goal, self.link, SafetyLayer(), radius=0.01)

    def cycle(self, points: np.ndarray) -> FlightCycle:
        self.now += 0.1
        self.ports.send_messages(self.telemetry.due(self.now, self.episode.motion))
        self.link.receive(self.now)
        scans = [self.assembler.push(self.now, packet) for packet in encode_scan(points, self.now)]
        return self.flight.step(self.now, next(scan for scan in scans if scan is not None))

    def command(self) -> np.ndarray:
        """What the vehicle is told to fly."""
        motion = self.episode.motion
        told = [each for each in self.ports.heard() if each.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        return read_setpoint(told[-1], motion.yaw).command(motion.position, motion.yaw)

    def close(self) -> None:
        self.link.close()
        self.ports.close()


def flown(wire: Wire, env: Any) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """The states that the flight has read, those of the simulator, and what it was told to fly."""
    state = env.reset(task=TASK)
    for _ in range(12):  # the pilot hovers
        wire.cycle(state["point_cloud"][0].numpy())
    wire.pilot.mode = wire.pilot.dialect.ours
    wire.telemetry.request(0)  # which the next heartbeat tells
    expected, commands = [], []
    for _ in range(STEPS):
        expected.append(state["observation"][0].numpy())
        assert wire.cycle(state["point_cloud"][0].numpy()).status.state in (State.FLYING, State.FENCED)
        commands.append(wire.command())
        state = env.step(state.set("action", torch.as_tensor(commands[-1], dtype=torch.float32)[None]))["next"]
    frames = wire.policy.contract.state.frames
    found, wanted = (np.reshape(each, (STEPS, frames, -1)) for each in (wire.read[-STEPS:], expected))
    return found, wanted, commands


@pytest.mark.parametrize("perception", ["range_image", "truncated_icosahedron"])
def test_it_reads_the_states_of_the_simulator(perception: str, tmp_path: Path) -> None:
    """Cells, altitude, heading and elevation with their signs, the order of the frames, the last action."""
    overrides = [*VALLEY, f"perception={perception}", "perception.last_action=true", "perception.lidar.max_range=6"]
    folder, settings = exported(tmp_path, *overrides), validate(compose("run_dir=here", *overrides))
    env = make_env(settings.env, settings.perception, tasks=[TASK], seed=settings.seed, num_uavs=1, keep_cloud=True)
    with closing(Wire(folder, env)) as wire:
        found, wanted, commands = flown(wire, env)
    terms, cells = wire.policy.contract.state, wire.policy.contract.cells.count
    assert found.shape == wanted.shape == (STEPS, terms.frames, cells + 7)
    np.testing.assert_allclose(found[..., cells:], wanted[..., cells:], rtol=0, atol=2e-5)
    # 4 mm; a ray on the border of two cells may come to lie in the other one, where a surface is a little nearer.
    assert np.quantile(np.abs(found[..., :cells] - wanted[..., :cells]), 0.95) < 1e-3
    assert np.ptp(wanted[..., cells:], axis=(0, 1)).min() > 0.0 and np.ptp(commands, axis=0).min() > 0.0
    env.close()


def test_it_sees_move_what_the_simulator_sees_move(tmp_path: Path) -> None:
    """By the packets' points, and the velocity and attitude of MAVLink, whose axes are others."""
    overrides = [*VALLEY, "perception=range_image", "perception.motion=12", "perception.lidar.max_range=12"]
    overrides += ["env.world.planes=4", "env.world.plane_keep_out=2"]
    folder, settings = exported(tmp_path, *overrides), validate(compose("run_dir=here", *overrides))
    env = make_env(settings.env, settings.perception, tasks=[TASK], seed=settings.seed, num_uavs=1, keep_cloud=True)
    with closing(Wire(folder, env)) as wire:
        found, wanted, _ = flown(wire, env)
    env.close()
    told, true = (each[:, -1, 75:96].reshape(STEPS, 3, 7) for each in (found, wanted))
    both = (told[..., 6] > 0) & (true[..., 6] > 0)
    assert both.sum() > 5 and ((told[..., 6] > 0) != (true[..., 6] > 0)).sum() <= 3
    apart = np.abs(told - true)[both]
    assert np.median(apart[:, :3]) < 0.01 and np.median(apart[:, 3:6]) < 0.05, "12 cm, 0.25 m/s"
    np.testing.assert_allclose(found[0], wanted[0], rtol=0, atol=0.02)
