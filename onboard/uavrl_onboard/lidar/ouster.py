"""From the packets of an Ouster sensor to scans."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uavrl_onboard.lidar.ouster_metadata import UNSEEN, read_metadata
from uavrl_onboard.lidar.scans import LONGEST_TURN, Scan, Skipped

_RESTART = 10  # turns by which frame numbers jump where the sensor has started anew
_LIDAR, _LEGACY = 1, "LEGACY"  # type of a lidar packet, which legacy packets do not carry
_TIME, _COLUMN, _STATUS = 0, 2, 3  # numbers of what a column says of itself, as `ouster.sdk.core.ColHeader` has them
_NAMED = 3  # serial numbers in a sentence


class OusterAssembler:
    """Joins the packets of an Ouster sensor, one at a time, to scans of a full turn each.

    A scan ends with the packet that completes its turn, or with the first one of the next turn. What is no lidar packet
    of the metadata's sensor is counted and left out, as is a turn that takes longer than 0.3 s or has a gap of more
    than 30 degrees. With two returns per ray, a scan holds both.

    Args:
        metadata: file with the metadata of the sensor.

    Attributes:
        skipped: what was left out so far.
        heard: whether there was any packet.
        port: UDP port to which the sensor sends.

    Raises:
        UavrlError: as of :func:`uavrl_onboard.lidar.ouster_metadata.read_metadata`.
    """

    def __init__(self, metadata: str | Path) -> None:
        self.metadata = Path(metadata)
        self.format = read_metadata(self.metadata)
        self.skipped, self.port = Skipped(), self.format.port
        self.heard = False
        self.serials = set[int]()  # of other sensors
        self._packets = self.format.packets
        self._has_types = self._packets.udp_profile_lidar.name != _LEGACY
        self._beams, self._columns = self.format.directions.shape[:2]
        self._frame: int | None = None  # number of the newest turn
        self._ended = True  # whether its scan is out, or given up
        self._given_up = False
        self._first = True  # whether it may have begun before we listened
        self._begun = 0  # ns of the sensor's clock
        self._count = 0  # of its packets
        self._late = 0  # packets in a row that came late
        self._seen = np.zeros(self._columns, bool)
        self._ranges = np.zeros((len(self.format.returns), self._beams, self._columns), np.uint32)

    def is_data(self, packet: bytes) -> bool:
        """Whether a packet is a lidar packet of any sensor with this format."""
        right_size = len(packet) == self._packets.lidar_packet_size
        return right_size and (not self._has_types or self._packets.packet_type(packet) == _LIDAR)

    def is_ours(self, packet: bytes) -> bool:
        """Whether a lidar packet carries the serial number of the metadata; legacy packets carry none."""
        return not self._has_types or not self.format.serial or self._packets.prod_sn(packet) == self.format.serial

    def push(self, stamp: float, packet: bytes) -> Scan | None:
        """Take a packet that arrived at ``stamp`` seconds; return the scan that it closes, if it closes one."""
        self.heard, closed = True, None
        if not self._is_taken(packet):
            return None
        buffer = np.frombuffer(packet, np.uint8)
        valid = (self._packets.packet_header(_STATUS, buffer) & 1).astype(bool)
        columns = self._packets.packet_header(_COLUMN, buffer)[valid]
        if not columns.size:  # beside the azimuth window
            return None
        if columns.max() >= self._columns:
            self.skipped.damaged += 1
            return None
        time = int(self._packets.packet_header(_TIME, buffer)[valid][0])
        number = int(self._packets.frame_id(buffer))
        after = self._after(number)
        if self._frame is None or abs(after) > _RESTART or self._late > self._whole_turn:
            self._give_up()
            self._begin(number, time, first=True)
        elif after == 0 and self._given_up:
            return None
        elif after < 0 or (after == 0 and self._ended):
            self._late += 1
            self.skipped.late += 1
            self.skipped.lost = max(self.skipped.lost - 1, 0)
            return None
        elif after > 0:
            self.skipped.lost += (after - 1) * self._whole_turn
            if abs(time - self._begun) > LONGEST_TURN * 1000:  # after a silence, what the turn holds is old
                self._give_up()
            closed = self._close(stamp)
            self._begin(number, time)
        elif abs(time - self._begun) > LONGEST_TURN * 1000:
            self._give_up()
            return None
        self._take(buffer, columns, valid)
        return closed or (self._close(stamp) if self._seen[self.format.window].all() else None)

    def finish(self, stamp: float) -> Scan | None:
        """Return the open turn, when no packet comes any more, if it lacks no more than one packet."""
        missing = int((self.format.window & ~self._seen).sum())
        return self._close(stamp) if missing <= self._packets.columns_per_packet else None

    def trouble(self) -> str:
        """Why no scan came out, as a sentence's second half."""
        if self.serials:
            others = ", ".join(str(each) for each in sorted(self.serials)[:_NAMED])
            return (
                f"its packets come from the sensor with the serial number {others}, and {self.metadata} is of "
                f"{self.format.serial}: give the metadata of the sensor that sent them."
            )
        left_out = "; ".join(self.skipped.sentences()) or "too few packets for one turn"
        size = f"a lidar packet of {self.metadata} has {self._packets.lidar_packet_size:,} bytes"
        return (
            f"it holds no full turn of an {self.format.name} ({left_out}); {size}: if the sensor's settings have "
            "changed, save its metadata again."
        )

    @property
    def _whole_turn(self) -> int:
        """Packets of a turn."""
        return -(-int(self.format.window.sum()) // self._packets.columns_per_packet)

    def _is_taken(self, packet: bytes) -> bool:
        """Whether a packet is one of the sensor's; else it is counted."""
        if not self.is_data(packet):
            if len(packet) == self._packets.imu_packet_size:
                self.skipped.imu += 1
            elif len(packet) == self._packets.lidar_packet_size:
                self.skipped.damaged += 1
            else:
                self.skipped.other_size += 1
            return False
        if not self.is_ours(packet):
            self.skipped.other_serial += 1
            if len(self.serials) < _NAMED:
                self.serials.add(self._packets.prod_sn(packet))
            return False
        return True

    def _after(self, number: int) -> int:
        """How many turns after the newest one a turn is; numbers begin anew after the largest."""
        if self._frame is None:
            return 0
        turns = int(self._packets.max_frame_id) + 1
        return (number - self._frame + turns // 2) % turns - turns // 2

    def _begin(self, number: int, time: int, first: bool = False) -> None:
        self._frame, self._begun, self._first, self._ended = number, time, first, False
        self._given_up = False
        self._count = 0
        self._seen[:] = False
        self._ranges[:] = 0

    def _take(self, buffer: np.ndarray, columns: np.ndarray, valid: np.ndarray) -> None:
        self._late = 0
        self._count += not self._seen[columns].all()  # a packet that came twice counts once
        self._seen[columns] = True
        for ranges, name in zip(self._ranges, self.format.returns, strict=True):
            ranges[:, columns] = self._packets.packet_field(name, buffer)[:, valid]

    def _give_up(self) -> None:
        self.skipped.incomplete += not self._ended
        self._ended = self._given_up = True

    def _close(self, stamp: float) -> Scan | None:
        """The scan of the open turn, if it has no wide gap."""
        if self._ended:
            return None
        missing = self.format.window & ~self._seen
        if self._first:  # what was before its first packet was not lost
            missing[: int(self._seen.argmax())] = False
        self.skipped.lost += -(-int(missing.sum()) // self._packets.columns_per_packet)
        if 360.0 * _longest_gap(self._seen) / self._columns > UNSEEN:
            self.skipped.incomplete += not self._first
            self._ended = True
            return None
        self._ended = True
        hit = self._ranges > 0
        points = [
            self.format.directions[each] * (1e-3 * ranges[each, None]).astype(np.float32) + self.format.origins[each]
            for each, ranges in zip(hit, self._ranges, strict=True)
        ]
        rays = self._beams * int(self._seen.sum())
        return Scan(stamp, np.concatenate(points), rays, rays - int(hit.any(0).sum()), self._count)


def _longest_gap(seen: np.ndarray) -> int:
    """How many columns in a row, around the turn, were not seen.

    Examples:
        >>> _longest_gap(np.array([False, True, True, False, False]))
        3
    """
    at = np.flatnonzero(seen)
    return len(seen) if not len(at) else int(np.diff(at, append=at[0] + len(seen)).max()) - 1
