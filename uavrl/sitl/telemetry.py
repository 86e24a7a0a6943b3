"""What an autopilot tells of its vehicle, and how often: MAVLink messages made of a simulated motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from uavrl.sitl.simulated_autopilot import AUTOPILOT_VERSION, SimulatedAutopilot
from uavrl_onboard.autopilot.frames import swap_world
from uavrl_onboard.geometry import attitude_of, quaternion

if TYPE_CHECKING:
    from uavrl.sitl.live import Motion

RATES = {0: 1.0, 1: 2.0, 24: 1.0, 30: 50.0, 31: 50.0, 32: 50.0, 33: 5.0, 147: 1.0, 242: 0.5, 245: 2.0, 331: 30.0}
"""Hz at the start: HEARTBEAT, SYS_STATUS, GPS_RAW_INT, ATTITUDE, ATTITUDE_QUATERNION, LOCAL_POSITION_NED,
GLOBAL_POSITION_INT, BATTERY_STATUS, HOME_POSITION, EXTENDED_SYS_STATE, ODOMETRY.
AUTOPILOT_VERSION is sent when asked for."""
ORIGIN = (47.397742, 8.545594, 488.0)  # latitude, longitude, m: where PX4's own simulators stand
_EARTH = 6_371_000.0  # m
_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # from east, north, up
_TO_FRD = np.diag([1.0, -1.0, -1.0])  # from forward, left, up
_QUADROTOR, _STANDBY, _ACTIVE, _IN_AIR = 2, 3, 4, 2
_CUSTOM, _GUIDED, _STABILIZED, _ARMED = 1, 8, 16, 128  # MAV_MODE_FLAG
_SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x8000 | 0x10000 | 0x200000 | 0x2000000 | 0x10000000
# gyro, accelerometer, compass, barometer, GPS, motors, RC, AHRS, battery, checks before arming
_CAPABILITIES = 1 << 7 | 1 << 13  # set-points in the local frame, MAVLink 2
_MILLIVOLT, _UNKNOWN = 16_000, 65_535


class Telemetry:
    """Sends what is due, and what is asked for.

    Args:
        messages: pymavlink's messages.
        autopilot: whose modes it tells, and whose requests it answers.
    """

    def __init__(self, messages: ModuleType, autopilot: SimulatedAutopilot) -> None:
        self._messages, self._autopilot = messages, autopilot
        self._made: dict[int, Callable[[int, Motion], Any]] = {
            0: self._heartbeat,
            1: self._status,
            24: self._gps,
            30: self._attitude,
            31: self._quaternion,
            32: self._local,
            33: self._global,
            147: self._battery,
            AUTOPILOT_VERSION: self._version,
            242: self._home,
            245: self._extended,
            331: self._odometry,
        }
        self._every = {number: 1.0 / rate for number, rate in RATES.items()}
        self._due = dict.fromkeys(self._every, -math.inf)
        self._asked: list[int] = []
        autopilot.set_interval, autopilot.request = self.set_interval, self.request

    def set_interval(self, number: int, interval: float) -> bool:
        """Obeys MAV_CMD_SET_MESSAGE_INTERVAL: µs between two, -1 for none, 0 for the first rate. False: unknown."""
        if number not in self._made:
            return False
        every = 1.0 / RATES[number] if interval == 0 and number in RATES else interval * 1e-6
        self._every[number] = every if every > 0 else math.inf
        self._due[number] = -math.inf if every > 0 else math.inf
        return True

    def request(self, number: int) -> bool:
        """Obeys MAV_CMD_REQUEST_MESSAGE. False: unknown."""
        if number in self._made:
            self._asked.append(number)
        return number in self._made

    def due(self, now: float, motion: Motion) -> list[Any]:
        """What is to be sent at ``now``, of a motion of that time; call it more often than 50 times a second."""
        late = [number for number, due in self._due.items() if now >= due - 1e-6]
        for number in late:
            after = self._due[number] + self._every[number]
            self._due[number] = after if after > now else now + self._every[number]
        asked, self._asked = self._asked, []
        return [self.message(number, now, motion) for number in dict.fromkeys([*asked, *late])]

    def message(self, number: int, now: float, motion: Motion) -> Any:
        """One message."""
        return self._made[number](int(now * 1000.0) % 2**32, motion)

    def _heartbeat(self, boot_ms: int, motion: Motion) -> Any:
        pilot = self._autopilot
        base_mode = _CUSTOM | _STABILIZED | _GUIDED | (_ARMED if pilot.armed else 0)
        state = _ACTIVE if pilot.armed else _STANDBY
        kind = (_QUADROTOR, pilot.dialect.autopilot)
        return self._messages.MAVLink_heartbeat_message(*kind, base_mode, pilot.mode, state, 3)

    def _status(self, boot_ms: int, motion: Motion) -> Any:
        sensors, load, none = (_SENSORS,) * 3, 100, (0,) * 6
        return self._messages.MAVLink_sys_status_message(*sensors, load, _MILLIVOLT, -1, 100, *none)

    def _extended(self, boot_ms: int, motion: Motion) -> Any:
        return self._messages.MAVLink_extended_sys_state_message(0, _IN_AIR)

    def _battery(self, boot_ms: int, motion: Motion) -> Any:
        volts = [_MILLIVOLT // 4] * 4 + [_UNKNOWN] * 6
        return self._messages.MAVLink_battery_status_message(0, 1, 1, 2500, volts, -1, -1, -1, 100)

    def _attitude(self, boot_ms: int, motion: Motion) -> Any:
        return self._messages.MAVLink_attitude_message(boot_ms, *euler(motion.rotation), *(_TO_FRD @ motion.rates))

    def _quaternion(self, boot_ms: int, motion: Motion) -> Any:
        turn = quaternion(*euler(motion.rotation))
        return self._messages.MAVLink_attitude_quaternion_message(boot_ms, *turn, *(_TO_FRD @ motion.rates))

    def _local(self, boot_ms: int, motion: Motion) -> Any:
        place, speed = swap_world(motion.position.tolist()), swap_world(motion.velocity.tolist())
        return self._messages.MAVLink_local_position_ned_message(boot_ms, *place, *speed)

    def _odometry(self, boot_ms: int, motion: Motion) -> Any:
        local, body = 1, 12  # MAV_FRAME_LOCAL_NED, MAV_FRAME_BODY_FRD
        place, turn = swap_world(motion.position.tolist()), quaternion(*euler(motion.rotation))
        speed = (_TO_FRD @ motion.rotation.T @ motion.velocity).tolist()
        rates, unknown, vision = (_TO_FRD @ motion.rates).tolist(), [math.nan] * 21, 0
        first = (boot_ms * 1000, local, body, *place, turn)
        return self._messages.MAVLink_odometry_message(*first, *speed, *rates, unknown, unknown, 0, vision)

    def _place(self, motion: Motion) -> tuple[int, int, int]:
        """Latitude and longitude in 1e-7 degrees, altitude in mm."""
        east, north, up = motion.position
        latitude = ORIGIN[0] + math.degrees(north / _EARTH)
        longitude = ORIGIN[1] + math.degrees(east / (_EARTH * math.cos(math.radians(ORIGIN[0]))))
        return round(latitude * 1e7), round(longitude * 1e7), round((ORIGIN[2] + up) * 1000)

    def _global(self, boot_ms: int, motion: Motion) -> Any:
        speed = [round(100 * each) for each in swap_world(motion.velocity.tolist())]
        heading = round(100 * math.degrees(euler(motion.rotation)[2])) % 36_000
        place, above = self._place(motion), round(1000 * motion.position[2])
        return self._messages.MAVLink_global_position_int_message(boot_ms, *place, above, *speed, heading)

    def _gps(self, boot_ms: int, motion: Motion) -> Any:
        fix_3d, satellites, speed = 3, 12, round(100 * float(np.hypot(*motion.velocity[:2])))
        place = self._place(motion)
        quality = (70, 110, speed, _UNKNOWN, satellites)
        return self._messages.MAVLink_gps_raw_int_message(boot_ms * 1000, fix_3d, *place, *quality)

    def _home(self, boot_ms: int, motion: Motion) -> Any:
        place = (round(ORIGIN[0] * 1e7), round(ORIGIN[1] * 1e7), round(ORIGIN[2] * 1000))
        level = [1.0, 0.0, 0.0, 0.0]
        return self._messages.MAVLink_home_position_message(*place, *[0.0] * 3, level, *[0.0] * 3)

    def _version(self, boot_ms: int, motion: Motion) -> Any:
        none, simulated = [0] * 8, 1
        return self._messages.MAVLink_autopilot_version_message(
            _CAPABILITIES, 0, 0, 0, 0, none, none, none, 0, 0, simulated
        )


def euler(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad, from north to the right, of a rotation ``[3, 3]`` from the body to the world.

    Examples:
        >>> [round(each, 6) + 0.0 for each in euler(np.eye(3))]  # it faces east
        [0.0, 0.0, 1.570796]
    """
    roll, pitch, yaw = attitude_of(_TO_NED @ rotation @ _TO_FRD).tolist()
    return roll, pitch, yaw
