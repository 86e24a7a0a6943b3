"""A simulated vehicle as a real one: scans and MAVLink, in real time or in step with its companion."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from uavrl.errors import UavrlError
from uavrl.sitl.faults import POSE, Faults
from uavrl.sitl.lidar_output import CloudOutput, LidarOutput, Message, PacketOutput
from uavrl.sitl.ports import SitlPorts
from uavrl.sitl.simulated_autopilot import FirmwareName, SimulatedAutopilot
from uavrl.sitl.telemetry import Telemetry
from uavrl_onboard.autopilot.mavlink import PORT as AUTOPILOT_PORT
from uavrl_onboard.autopilot.mavlink import mavlink
from uavrl_onboard.lidar.packets import PORT as LIDAR_PORT
from uavrl_onboard.vehicle import VEHICLE

if TYPE_CHECKING:
    from uavrl.sitl.live import LiveEpisode

_logger = logging.getLogger(__name__)

ROS2 = "ros2:"  # what an address of a topic begins with
LIDAR, AUTOPILOT = (f"udp://127.0.0.1:{port}" for port in (LIDAR_PORT, AUTOPILOT_PORT))
LATE = 0.1  # s behind its time, after which the simulator gives up catching up
TURN = 0.1  # s of the LiDAR
HELD = 0.9  # of real time: a companion that measures ages takes poses of a slower clock for old ones
TOO_SLOW = (
    "Its clock went slower than real time, and a companion such as uavrl-fly then takes its poses for old: look at the "
    "processor's load, or lower perception.lidar.max_range."
)
_TICK = 0.02  # s between two looks while a set-point is waited for


@dataclass
class Result:
    """How an episode ended, and how well its time was kept."""

    outcome: str = "stopped"  #: success, collision, time_out, or stopped
    seconds: float = 0.0  #: from the first set-point that was obeyed
    steps: int = 0  #: of 0.1 s, likewise
    distance: float = math.inf  #: horizontally to the middle of the goal at the end, m
    least_distance: float = math.inf  #: likewise, in all, m
    setpoints: int = 0  #: that were obeyed
    rate: float = 1.0  #: share of the asked speed that was held
    packets_late_ms: tuple[float, float] = (0.0, 0.0)  #: median and most by which LiDAR packets, or clouds, were late
    modes: list[tuple[float, str, str]] = field(default_factory=list)  #: time in s, mode, reason
    began_at: float | None = None  #: when the first set-point was obeyed, s since 1970

    def facts(self) -> dict[str, Any]:
        """By name, with no number that JSON has not."""
        finite = {name: None if value == math.inf else value for name, value in asdict(self).items()}
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in finite.items()}


class Sitl:
    """Runs one episode.

    In real time the vehicle flies in pieces of 12.5 ms: a set-point acts from the piece after its arrival on. Each
    LiDAR packet, or cloud, shows what is around the vehicle when its rays are fired, and is sent when the last one has
    been. With ``speed="lockstep"`` the simulator stands still until a set-point is obeyed, which then acts for a step
    of 0.1 s; after it comes a whole scan, as the environment gives it.

    Args:
        episode: the task, which has begun.
        lidar: where scans go: ``udp://HOST:PORT`` for the packets of a VLP-16, ``ros2:///TOPIC`` for the clouds of any
            LiDAR.
        autopilot: where MAVLink goes.
        firmware: whose rules the vehicle follows.
        armed: whether it is armed at the start.
        speed: seconds in a second, or ``"lockstep"``.
        max_steps: steps of 0.1 s until the time is out.
        max_speed: limit of each component of the velocity in m/s.
        patience: how long to wait for a companion computer, in s of its clock or of real time, whichever is over first.
        linger: seconds of hovering after the end.
        pilot_takes_over: seconds after the first obeyed set-point at which the pilot takes the mode; None: never.
        faults: what goes wrong.

    Raises:
        UavrlError: where pymavlink is missing, or cyclonedds for ROS 2, or an address is none.
    """

    def __init__(
        self,
        episode: LiveEpisode,
        lidar: str = LIDAR,
        autopilot: str = AUTOPILOT,
        *,
        firmware: FirmwareName = "px4",
        armed: bool = True,
        speed: float | Literal["lockstep"] = 1.0,
        max_steps: int = 300,
        max_speed: float = VEHICLE.velocity_limit,
        patience: float = 60.0,
        linger: float = 1.0,
        pilot_takes_over: float | None = None,
        faults: Faults | None = None,
    ) -> None:
        messages = mavlink()
        self._episode, self._faults = episode, faults or Faults()
        self._lockstep, self._speed = speed == "lockstep", 1.0 if speed == "lockstep" else float(speed)
        self._max_speed = max_speed
        self._max_steps, self._patience, self._linger, self._pilot = max_steps, patience, linger, pilot_takes_over
        self.autopilot = SimulatedAutopilot(messages, firmware, armed=armed)
        self._telemetry = Telemetry(messages, self.autopilot)
        self._lidar = self._output(lidar)
        try:
            self._ports = SitlPorts(messages, autopilot, self.autopilot.system, self._faults.signing_key_file)
        except UavrlError:
            self._lidar.close()
            raise
        self._packets: deque[tuple[float, Message]] = deque()  # with their times
        self._lateness: list[float] = []
        self._wanted: float | None = None  # when the first set-point was obeyed
        self._ended: float | None = None
        self._flown = 0.0  # s of the vehicle's clock
        self._lost, self._begun = 0.0, 0.0
        self.result = Result(modes=self.autopilot.changes)

    def _output(self, address: str) -> LidarOutput:
        """What sends the scans to an address."""
        if not address.startswith(ROS2):
            return PacketOutput(address)
        if self._faults.product is not None:
            raise UavrlError("faults.product is a byte of packets, and the clouds of ROS 2 have none: leave it out.")
        return CloudOutput(address, self._episode.last_firing)

    def close(self) -> None:
        """Gives its ports back."""
        self._lidar.close()
        self._ports.close()

    def run(self) -> Result:
        """Flies until the episode has ended and the vehicle has lingered.

        Raises:
            UavrlError: where no companion takes control, or in lockstep none answers.
        """
        self._begun = time.monotonic()
        try:
            self._run_in_step() if self._lockstep else self._run_in_time()
        finally:
            self._conclude()
        return self.result

    @property
    def _now(self) -> float:
        """Seconds of the vehicle's clock."""
        return (time.monotonic() - self._begun - self._lost) * self._speed

    def _run_in_time(self) -> None:
        from uavrl.sitl.live import PIECE, PIECES

        piece = 0
        while not self._is_over(piece * PIECE):
            now, turn = piece * PIECE, piece // PIECES
            self._govern(now)
            self._tell(now)
            velocity, yaw_rate = self._demand(now)
            rays = self._episode.piece(velocity, yaw_rate)
            self._packets += self._lidar.add(self._episode.points, rays, turn * TURN)
            self._note(now + PIECE)
            piece += 1
            self._flown = piece * PIECE
            self._wait(self._flown)

    def _run_in_step(self) -> None:
        step, waited = 0, time.monotonic()
        while not self._is_over(now := self._now):
            before = self.autopilot.setpoints
            self._tell(now, pose=True)
            self._send(self._lidar.whole(self._episode.points, now), now)
            self._await_setpoint(now + TURN, waited + self._patience)
            target = self.autopilot.setpoint(self._now)
            if self.autopilot.setpoints > before and target is not None and self._ended is None:
                motion = self._episode.motion
                self._episode.step(target.command(motion.position, motion.yaw, self._max_speed))
                step, waited = step + 1, time.monotonic()
                self._note(self._now, step)

    def _await_setpoint(self, scan: float, latest: float) -> None:
        """Waits for a set-point that is obeyed; while none is, and at the end, only until the next scan is due."""
        before = self.autopilot.setpoints
        while self.autopilot.setpoints == before:
            self._hear_within(_TICK)
            now = self._now
            self._govern(now)
            self._tell(now)
            if now >= scan and (not self.autopilot.in_control or self._ended is not None):
                return
            if time.monotonic() > latest and self._ended is None:
                raise UavrlError(f"No set-point was obeyed for {self._patience:g} s: {self._who_flies()}.")

    def _is_over(self, now: float) -> bool:
        """Whether the episode has ended and the vehicle has lingered; refuses to wait for ever."""
        waited = max(now, time.monotonic() - self._begun)  # its clock may go slower, or faster
        if self._wanted is None and not self._lockstep and waited > self._patience:
            slow = f" {TOO_SLOW}" if self._speed * self._share_held() < HELD else ""
            raise UavrlError(f"No companion took control within {self._patience:g} s: {self._who_flies()}.{slow}")
        return self._ended is not None and now >= self._ended + self._linger

    def _who_flies(self) -> str:
        pilot = self.autopilot
        armed = "" if pilot.armed else ", not armed"
        ours = pilot.dialect.firmware.mode_name(pilot.dialect.ours)
        return f"the vehicle is in {pilot.mode_name}{armed}; set-points are obeyed in {ours}"

    def _govern(self, now: float) -> None:
        """What changes by itself: a failsafe, the pilot, motors that were stopped."""
        self._hear(now)
        self.autopilot.tick(now)
        if self._pilot is not None and self._wanted is not None and now - self._wanted >= self._pilot:
            self.autopilot.take_over(now)
            self._pilot = None
        if self.autopilot.fell:
            self._episode.stop_motors()

    def _demand(self, now: float) -> tuple[np.ndarray, float]:
        """The velocity in the world's axes and the yaw rate that the vehicle is to have."""
        target = self.autopilot.setpoint(now) if self._ended is None else None
        if target is None:
            return np.zeros(3), 0.0
        motion = self._episode.motion
        return target.demand(motion.position, motion.yaw, self._max_speed)

    def _note(self, now: float, steps: int | None = None) -> None:
        """Keeps what has come of a piece or a step that ended at ``now``."""
        result = self.result
        if self._wanted is None and self.autopilot.setpoints:
            self._wanted, self.result.began_at = now, time.time()
        if self._wanted is None or self._ended is not None:
            return
        result.setpoints = self.autopilot.setpoints
        result.seconds = now - self._wanted if steps is None else steps * TURN
        result.steps = math.ceil(result.seconds / TURN - 1e-6)
        result.distance = self._episode.distance
        result.least_distance = min(result.least_distance, result.distance)
        if self._episode.outcome is not None or result.steps >= self._max_steps:
            result.outcome, self._ended = self._episode.outcome or "time_out", now

    def _conclude(self) -> None:
        self.result.rate = self._share_held()
        if self._lateness:
            late = 1000.0 * np.array(self._lateness)
            self.result.packets_late_ms = (round(float(np.median(late)), 3), round(float(late.max()), 3))
        self.close()

    def _share_held(self) -> float:
        """Which share of the asked speed was held."""
        asked = (time.monotonic() - self._begun) * self._speed
        return 1.0 if self._lockstep or not self._flown else min(self._flown / asked, 1.0)

    def _wait(self, until: float) -> None:
        """Sends what is due and hears what comes until a time of the vehicle's clock; what is late is sent first."""
        while True:
            now = self._now
            due = self._packets[0][0] if self._packets else math.inf
            if due <= now:
                when, packet = self._packets.popleft()
                self._lateness.append((now - when) / self._speed)
                self._send([packet], now)
            elif now < until:
                self._hear_within((min(due, until) - now) / self._speed)
            else:
                break
        behind = (now - until) / self._speed
        if behind > LATE:
            if not self._lost:
                _logger.warning(
                    "The simulator cannot hold speed=%g here: it is %.2f s behind, and its clock now goes slower. "
                    "Look at the processor's load; perception.lidar.max_range=4 needs less of it.",
                    self._speed,
                    behind,
                )
            self._lost += behind

    def _send(self, messages: list[Message], now: float) -> None:
        since = self._since(now)
        self._lidar.send(self._faults.of_lidar(messages, since))
        self._lidar.send_as_another(self._faults.of_second_sensor(messages, since))

    def _since(self, now: float) -> float | None:
        """Seconds since the first obeyed set-point."""
        return None if self._wanted is None else now - self._wanted

    def _tell(self, now: float, *, pose: bool = False) -> None:
        """Sends what telemetry is due, and the pose where it is asked for."""
        motion = self._episode.motion
        due = self._telemetry.due(now, motion)
        if pose:
            told = {message.get_msgId() for message in due}
            due += [self._telemetry.message(number, now, motion) for number in POSE if number not in told]
        if (beat := self._faults.camera_beats(now)) is not None:
            self._ports.send_beat_of_camera(beat)
        self._ports.send_messages(self._faults.of_telemetry(due, now, self._since(now)))

    def _hear_within(self, seconds: float) -> None:
        if self._ports.wait(seconds):
            self._hear(self._now)

    def _hear(self, now: float) -> None:
        """Reads all that has come, and answers."""
        for message in self._ports.heard():
            self.autopilot.hear(message, now, self._episode.motion.yaw)
        answers, self.autopilot.answers = self.autopilot.answers, []
        self._ports.send_messages(answers)
