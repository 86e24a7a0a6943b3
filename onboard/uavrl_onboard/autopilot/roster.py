"""Who speaks on a MAVLink link, and which of them is the vehicle."""

from __future__ import annotations

from typing import Any

from uavrl_onboard.autopilot.firmware import FIRMWARES, MULTIROTORS

Source = tuple[int, int]
"""System and component id of a sender."""

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1, which every autopilot has
TOGETHER = 3.0  # s: vehicles whose first heartbeats lie closer are there from the start; heartbeats come once a second
_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID
_NO_AIRFRAMES = {
    5: "an antenna tracker",
    6: "a ground station",
    18: "a companion computer",
    26: "a gimbal",
    27: "an ADS-B receiver",
    30: "a camera",
    **dict.fromkeys((31, 32, 33, 34, 36, 37, 38, 39, 40, 41, 42, 44, 48, 49), "a component"),
}
"""Of MAVLink's MAV_TYPE: heartbeats of what flies along or stays on the ground."""
_OTHER, _OTHER_AIRFRAME, _FLYABLE = range(3)


class Roster:
    """Chooses the vehicle from the heartbeats on a link.

    The vehicle is the autopilot component of an airframe. A multirotor with PX4 or ArduPilot comes before any other
    airframe, whichever is heard first; once there is one, no other component and no other system replaces it.

    Args:
        system: the vehicle's MAVLink system id; None: that of the first vehicle heard.

    Attributes:
        vehicle: system and component id of the vehicle, None before it was heard.
        others: what else was heard, by system and component id.
        rivals: systems of other vehicles that we could fly, each with the time since when it is heard.
    """

    def __init__(self, system: int | None = None) -> None:
        self.system = system
        self.vehicle: Source | None = None
        self.others: dict[Source, str] = {}
        self.rivals: dict[int, float] = {}
        self._rank, self._since = _OTHER, 0.0

    def admits(self, beat: Any, now: float) -> bool:
        """Take in a heartbeat; return whether it is the vehicle's."""
        source = beat.get_srcSystem(), beat.get_srcComponent()
        rank = _rank(beat, source)
        if self.system in (None, source[0]) and rank > _OTHER and (source == self.vehicle or rank > self._rank):
            if source != self.vehicle:
                self.vehicle, self._since = source, now
            self.others.pop(source, None)
            self._rank = rank
            return True
        self.note(beat, now)
        return False

    def note(self, beat: Any, now: float) -> None:
        """Take in a heartbeat of another component."""
        source = beat.get_srcSystem(), beat.get_srcComponent()
        self.others[source] = _name(beat)
        is_rival = _rank(beat, source) == _FLYABLE and self.vehicle is not None and source[0] != self.vehicle[0]
        if is_rival and self.system is None:
            self.rivals.setdefault(source[0], now)

    @property
    def is_ambiguous(self) -> bool:
        """True where another vehicle was there from the start, so that being heard first says nothing."""
        return any(since - self._since <= TOGETHER for since in self.rivals.values())

    def which(self) -> str:
        """Say how the user tells vehicles apart."""
        assert self.vehicle is not None
        systems = [str(system) for system in sorted({self.vehicle[0], *self.rivals})]
        asked = " or ".join(f"system={system}" for system in systems)
        return f"{len(systems)} vehicles send on this link, systems {' and '.join(systems)}: give {asked}"

    def missing(self) -> str:
        """Say that the vehicle was not heard, and who was."""
        wanted = "" if self.system is None else f" of system {self.system}"
        heard = [f"{name} ({system}/{component})" for (system, component), name in sorted(self.others.items())]
        return f"no autopilot{wanted} has been heard yet" + (f", only {', '.join(heard)}" if heard else "")


def _rank(beat: Any, source: Source) -> int:
    if source[1] != AUTOPILOT or beat.autopilot == _NO_AUTOPILOT or beat.type in _NO_AIRFRAMES:
        return _OTHER
    return _FLYABLE if beat.autopilot in FIRMWARES and beat.type in MULTIROTORS else _OTHER_AIRFRAME


def _name(beat: Any) -> str:
    if beat.type in _NO_AIRFRAMES:
        return _NO_AIRFRAMES[beat.type]
    firmware = FIRMWARES.get(beat.autopilot)
    kind = "a multirotor" if beat.type in MULTIROTORS else f"a vehicle of type {beat.type}"
    return kind if firmware is None else f"{kind} with {firmware.name}"
