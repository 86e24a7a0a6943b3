"""The log of a flight: an MCAP file of ROS 2 messages, which is written beside the loop and never holds it up."""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Thread
from typing import TYPE_CHECKING

from uavrl_onboard.autopilot.frames import Vector
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import new_file
from uavrl_onboard.flight.interfaces import FlightCycle
from uavrl_onboard.flight.log_messages import GOAL, TOPICS, FlightMessages
from uavrl_onboard.libraries import needed
from uavrl_onboard.policy.contract import CONTRACT
from uavrl_onboard.provenance import versions

if TYPE_CHECKING:
    from uavrl_onboard.policy.contract import Contract

FORMAT = "uavrl.flight 1"
ABOUT, END = "uavrl.flight", "uavrl.end"  # names of metadata records
FLUSH = 1.0  # s of a flight that a crash or an empty battery can take from its log
WAITING = 50  # cycles that may wait for a slow disk; then some are left out
_CHUNK = 2**16  # bytes before compression: a scan is more, and so a chunk of its own
_PATIENCE = 0.1  # s between two looks whether the flight has ended
_LONGEST_END = 20.0  # s that the end waits for a slow disk


class FlightLog:
    """Writes the cycles of one flight; a context manager, whose file is whole when it ends.

    A thread does the work: `write` only hands over. Where the disk is too slow, cycles are left out and counted. What
    is in the file is safe within a second, also from an empty battery, and a file that ends in the middle is read up to
    there by `uavrl_onboard.flight.logged_flight`.

    Args:
        path: the file; where there is one already, the name gets a number.
        contract: of the policy that flies.
        goal: x, y, z in the world's axes, m.
        sensor_position: of the LiDAR in body axes, m; the contract's by default.
        radius: the vehicle has arrived at this horizontal distance from the goal, m.
        live: whether a vehicle flies now. Those of a recording wait for the disk, and none is left out.
        clock: what the cycles' times are of, by default ``time.monotonic``, of a recording ``time.time``. One offset,
            taken at the start, leads from them to the time of the day.
        about: what else the file should say, such as the command.

    Attributes:
        path: the file that is written.
        left_out: how many cycles the disk was too slow for.

    Raises:
        UavrlError: where the file cannot be made, or `mcap` or `rosbags` is not installed.
    """

    def __init__(
        self,
        path: str | Path,
        contract: Contract,
        goal: Sequence[float],
        sensor_position: Vector | None = None,
        *,
        radius: float = 1.0,
        live: bool = True,
        clock: Callable[[], float] | None = None,
        about: dict[str, str] | None = None,
    ) -> None:
        sensor = sensor_position or contract.cloud.sensor_position
        writer = needed("mcap.writer", "A flight log", "log")
        clock = clock or (time.monotonic if live else time.time)
        offset = time.time_ns() - round(clock() * 1e9)
        self.messages = FlightMessages(offset, goal, sensor)
        try:
            if Path(path).is_dir():
                raise IsADirectoryError(errno.EISDIR, "it is a folder")
            self._file = new_file(Path(path))
        except OSError as error:
            raise UavrlError(
                f"{path} cannot be written ({error.strerror}): choose another file for the log."
            ) from error
        self.path, self.left_out = Path(self._file.name), 0
        self._queue: Queue[FlightCycle] = Queue(WAITING)
        self._patience = 0.0 if live else _LONGEST_END
        self._ending = False
        self._failure: Exception | None = None
        self._told = False
        self._writer = writer.Writer(self._file, _CHUNK, writer.CompressionType.ZSTD)
        facts = {
            "format": FORMAT,
            "started": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
            "clock_offset_ns": str(offset),
            "goal": json.dumps([float(number) for number in goal]),
            "radius": json.dumps(float(radius)),
            "sensor_position": json.dumps([float(number) for number in sensor]),
            "versions": json.dumps({name: found for name, found in versions().items() if found is not None}),
        }
        self._thread = Thread(target=self._work, args=((about or {}) | facts, contract), name="flight log", daemon=True)
        self._thread.start()

    def __enter__(self) -> FlightLog:
        """Gives itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the file."""
        self.close()

    def write(self, cycle: FlightCycle) -> None:
        """Hands over a cycle, in no time.

        Raises:
            UavrlError: once, where nothing can be written any more; further cycles are ignored.
        """
        self._tell()
        if self._failure is None:
            try:
                self._queue.put(cycle, self._patience > 0.0, self._patience or None)
            except Full:
                self.left_out += 1

    def close(self) -> None:
        """Writes what waits, and the end of the file.

        Raises:
            UavrlError: where nothing could be written any more, and `write` has not said so.
        """
        self._ending = True
        self._thread.join(_LONGEST_END)
        if self._thread.is_alive() and self._failure is None:
            self._failure = TimeoutError("the disk does not answer")
        self._tell()

    def _tell(self) -> None:
        if self._failure is not None and not self._told:
            self._told = True
            reason = getattr(self._failure, "strerror", None) or self._failure
            raise UavrlError(
                f"{self.path} cannot be written any more ({reason}): the log has ended, and holds what came before."
            ) from self._failure

    # The thread's part.

    def _work(self, facts: dict[str, str], contract: Contract) -> None:
        try:
            self._begin(facts, contract)
            self._save()
            saved = time.monotonic()
            while not (self._ending and self._queue.empty()):
                with suppress(Empty):
                    self._add(self._queue.get(timeout=_PATIENCE))
                if time.monotonic() - saved >= FLUSH:
                    self._save()
                    saved = time.monotonic()
            self._writer.add_metadata(END, {"left_out": str(self.left_out)})
            self._writer.finish()
            self._save()
        except Exception as error:  # of the disk, or a cycle of numbers that no message takes: the flight goes on
            self._failure = error
        finally:
            with suppress(OSError):  # a full disk refuses the rest again
                self._file.close()

    def _begin(self, facts: dict[str, str], contract: Contract) -> None:
        """Writes what does not change."""
        self._writer.start(profile="ros2")
        self._writer.add_metadata(ABOUT, facts)
        now = time.time_ns()
        text = contract.to_text()
        self._writer.add_attachment(now, now, CONTRACT, "application/json", text.encode())
        schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        for topic, kind in TOPICS.items():
            if kind not in schemas:
                schemas[kind] = self._writer.register_schema(kind, "ros2msg", self.messages.definition(kind))
            more = {"offered_qos_profiles": ""}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schemas[kind], more)
        self._goal_told = -float("inf")

    def _add(self, cycle: FlightCycle) -> None:
        messages = self.messages.encode(cycle)
        if abs(cycle.time - self._goal_told) >= FLUSH:
            self._goal_told = cycle.time
            messages.insert(0, (GOAL, self.messages.encode_goal(cycle.time)))
        stamp = self.messages.nanoseconds(cycle.time)
        for topic, data in messages:
            self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def _save(self) -> None:
        self._writer.flush()
        os.fsync(self._file.fileno())
