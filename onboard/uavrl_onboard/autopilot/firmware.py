"""What PX4 and ArduPilot call their modes, and how they are asked for one."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

MULTIROTORS = frozenset({2, 3, 4, 13, 14, 15, 29, 35, 43})
"""Of MAVLink's MAV_TYPE: quadrotor, coaxial, helicopter, hexa-, octo-, tri-, dodeca-, decarotor, any multirotor."""

_PX4_MODES = {
    **dict(enumerate(["MANUAL", "ALTCTL", "POSCTL", "AUTO", "ACRO", "OFFBOARD", "STABILIZED", "RATTITUDE"], 1)),
    **{9: "SIMPLE", 10: "TERMINATION", 11: "ALTITUDE_CRUISE"},
}
_PX4_AUTO_MODES = dict(
    enumerate(["READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "RTGS", "FOLLOW_TARGET", "PRECLAND"], 1)
)
_COPTER_MODES = {
    **dict(enumerate(["STABILIZE", "ACRO", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE"])),
    **{9: "LAND", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW"},
    **{19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG"},
    **{25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE"},
}


class Firmware(NamedTuple):
    """One autopilot's dialect."""

    name: str
    mode: str  #: in which it flies by set-points
    request: tuple[float, float]  #: the second and third parameter of MAV_CMD_DO_SET_MODE for that mode
    mode_name: Callable[[int], str]  #: of a heartbeat's ``custom_mode``


def px4_mode(custom_mode: int) -> str:
    """The name of a PX4 mode: the main mode is the third byte, the mode within AUTO the fourth.

    Examples:
        >>> px4_mode(6 << 16), px4_mode(4 << 16 | 5 << 24), px4_mode(99 << 16)
        ('OFFBOARD', 'AUTO.RTL', 'mode 99')
    """
    main, within = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = _PX4_MODES.get(main, f"mode {main}")
    return f"AUTO.{_PX4_AUTO_MODES.get(within, within)}" if name == "AUTO" and within else name


def copter_mode(custom_mode: int) -> str:
    """The name of a mode of ArduPilot's Copter.

    Examples:
        >>> copter_mode(4), copter_mode(10)
        ('GUIDED', 'mode 10')
    """
    return _COPTER_MODES.get(custom_mode, f"mode {custom_mode}")


FIRMWARES = {
    12: Firmware("PX4", "OFFBOARD", (6.0, 0.0), px4_mode),
    3: Firmware("ArduPilot", "GUIDED", (4.0, 0.0), copter_mode),
}
"""By a heartbeat's ``autopilot``, of MAVLink's MAV_AUTOPILOT."""
