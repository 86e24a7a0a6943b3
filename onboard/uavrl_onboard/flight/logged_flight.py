"""Reads the log of a flight, also one that ends in the middle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from uavrl_onboard.autopilot.vehicle_state import VehicleStatus
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log import ABOUT, END, FORMAT
from uavrl_onboard.flight.log_messages import STATUS, TOPICS, FlightMessages
from uavrl_onboard.flight.safety import SafetyStatus
from uavrl_onboard.lidar.mcap_file import MAGIC, McapFile
from uavrl_onboard.policy.contract import CONTRACT, LARGEST, Contract
from uavrl_onboard.policy.contract_parts import Three
from uavrl_onboard.ranges import Positive

FARTHEST = 1e6  # m
_STATUS, _CONTROL, _NUMBER = TypeAdapter(SafetyStatus), TypeAdapter(VehicleStatus), TypeAdapter(float | None)
REMEDY = "give a file that a flight has written"


class LoggedFlight:
    """The cycles of a flight, one after the other, from the file that `uavrl_onboard.flight.log.FlightLog` has written.

    Messages are read by the definitions of ROS 2 Humble, never by those that the file brings: nothing in it is run.

    Args:
        path: the file.

    Attributes:
        contract: of the policy that flew.
        goal: x, y, z in the world's axes, m.
        radius: the vehicle has arrived at this horizontal distance from the goal, m.
        sensor_position: of the LiDAR in body axes, m.
        about: what the file says of the flight: format, beginning, versions.
        left_out: how many cycles the disk was too slow for; known once the cycles are read.
        whole: whether the file has its end; known then.

    Raises:
        UavrlError: for a file that is no log of a flight, or a damaged one.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, McapFile(path, "log")
        self.left_out, self.whole = 0, False
        try:
            with path.open("rb") as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise UavrlError(f"{path} is no MCAP file: {REMEDY}.")
        except OSError as error:
            raise UavrlError(f"{path} cannot be read ({error.strerror}): {REMEDY}.") from error
        self.about, text = self._head()
        try:
            self.contract = Contract.model_validate_json(text)
            self.goal, self.sensor_position = (
                TypeAdapter(Three).validate_json(self.about[name]) for name in ("goal", "sensor_position")
            )
            self.radius = TypeAdapter(Positive).validate_json(self.about["radius"])
            if not max(map(abs, [*self.goal, *self.sensor_position, self.radius])) < FARTHEST:
                raise ValueError("a place beyond all flights")
            offset = int(self.about["clock_offset_ns"])
        except ValidationError as error:
            raise UavrlError(self._unread(error)) from error
        except (ValueError, KeyError) as error:
            raise UavrlError(f"The head of {path} is damaged: {REMEDY}.") from error
        if (wrong := self.contract.contradiction()) is not None:
            raise UavrlError(f"{path} is damaged, or another uavrl's ({wrong}): {REMEDY}.")
        self._messages = FlightMessages(offset, self.goal, self.sensor_position)

    def _unread(self, error: ValidationError) -> str:
        """Why the head cannot be read. Terms that a contract lacks are not guessed: cells could not be checked."""
        lacks = [".".join(map(str, each["loc"])) for each in error.errors() if each["type"] == "missing"]
        if error.title != "Contract" or "format" in lacks or len(lacks) < error.error_count():
            return f"The head of {self.path} is damaged: {REMEDY}."
        lacking = f"its contract has no {', '.join(lacks)}, and what it saw cannot be checked without"
        return f"{self.path} was written by an earlier uavrl: {lacking}. Read it with the one that wrote it."

    def _head(self) -> tuple[dict[str, str], bytes]:
        """What the log says of itself, and the contract in it."""
        about: dict[str, str] | None = None
        for record in self._file.records():
            kind = type(record).__name__
            if kind == "Metadata" and record.name == ABOUT:
                about = record.metadata
            elif kind == "Attachment" and record.name == CONTRACT and about is not None:
                if about.get("format") != FORMAT:
                    raise UavrlError(f"{self.path} is not of {FORMAT}, which this version of uavrl reads: {REMEDY}.")
                return about, bytes(record.data[:LARGEST])
            elif kind == "Message":
                break
        raise UavrlError(f"{self.path} is an MCAP file, and not the log of a flight: {REMEDY}.")

    def __iter__(self) -> Iterator[FlightCycle]:
        """Reads the cycles from the beginning."""
        topics: dict[int, str] = {}
        waiting: dict[str, bytes] = {}
        for record in self._file.records():
            kind = type(record).__name__
            if kind == "Channel":
                topics[record.id] = record.topic
            elif kind == "Message" and (topic := topics.get(record.channel_id)) in TOPICS:
                waiting[topic] = record.data
                if topic == STATUS:
                    yield self._cycle(record.log_time, waiting)
                    waiting = {}
            elif kind == "Metadata" and record.name == END:
                self._end(record.metadata)
        self.whole = self._file.whole

    def _cycle(self, log_time: int, messages: dict[str, bytes]) -> FlightCycle:
        try:
            cycle = self._messages.decode(log_time, messages)
            _STATUS.validate_python(asdict(cycle.status))
            _CONTROL.validate_python(asdict(cycle.control))
            for number in (cycle.distance, cycle.latency, cycle.turn):
                _NUMBER.validate_python(number, strict=True)
            if cycle.cells is not None and cycle.cells.shape != (self.contract.cells.count,):
                raise ValueError(f"{len(cycle.cells)} cells")
            return cycle
        except Exception as error:  # a damaged message meets any of its fields' types
            raise UavrlError(f"{self.path} holds a message that no flight has written: {REMEDY}.") from error

    def _end(self, said: dict[str, Any]) -> None:
        self.left_out = int(said["left_out"]) if str(said.get("left_out")).isdecimal() else 0
