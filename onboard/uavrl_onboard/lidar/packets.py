"""The data packets of a Velodyne sensor (VLP-16 user manual 63-9243): their format, both ways."""

from __future__ import annotations

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.geometry import NEAREST_RETURN, spherical
from uavrl_onboard.lidar.vlp16 import AZIMUTH_STEP, AZIMUTH_STEPS, CYCLE, LASER_ELEVATIONS, LASER_INTERVAL

PORT = 2368  # UDP, of data packets
PACKET_SIZE = 1206  # bytes of a data packet
POSITION_SIZE = 512  # bytes of a position packet, which the sensor sends beside them
BLOCKS, CHANNELS = 12, 32  # of a packet; in a VLP-16's block its 16 lasers fire twice
FLAG = 0xEEFF  # at the beginning of each block
STEP = 0.002  # m, what a distance of 1 means
FULL_TURN = 36_000  # hundredths of a degree
HOUR = 3_600_000_000  # microseconds, after which the sensor's clock begins anew
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39  # which return is reported

PRODUCTS = {"VLP16": 0x22, "PuckHiRes": 0x24, "HDL32E": 0x21, "VLP32A": 0x23, "VLP32B": 0x23, "VLP32C": 0x28}
"""The models that are decoded, each with its product byte."""
PACKET_TIMES = {
    "VLP16": 1327.1,
    "PuckHiRes": 1327.1,
    "HDL32E": 553.0,
    "VLP32A": 663.6,
    "VLP32B": 663.6,
    "VLP32C": 663.6,
}
"""Microseconds from one packet to the next with one return per ray; with two, it is half as long."""

_BLOCK = np.dtype(
    [
        ("flag", "<u2"),
        ("azimuth", "<u2"),  # clockwise seen from above, 0 straight ahead
        ("returns", [("distance", "<u2"), ("reflectivity", "u1")], CHANNELS),
    ]
)
PACKET = np.dtype([("blocks", _BLOCK, BLOCKS), ("time", "<u4"), ("mode", "u1"), ("product", "u1")])
"""A data packet; ``time`` is that of the first firing in microseconds past the hour."""

_LASERS = len(LASER_ELEVATIONS)
_BLOCK_TIME = CHANNELS // _LASERS * CYCLE  # s, from one block of a VLP-16 to the next
PACKET_TIME = BLOCKS * _BLOCK_TIME  # s, from one packet of a VLP-16 to the next: 1.327 ms
PACKETS = -(-AZIMUTH_STEPS * _LASERS // (BLOCKS * CHANNELS))  # that hold a turn: 76
_REFLECTIVITY = 100  # of what is simulated: that of a diffuse white thing


def encode_scan(points: np.ndarray, stamp: float = 0.0) -> list[bytes]:
    """Writes one simulated scan as the 76 data packets that a VLP-16 at 10 Hz would send of it.

    The last packet has more room than the scan needs, and is filled with misses. Packets report the strongest return.
    What the sensor cannot say is a miss: what is farther than 131 m, or within its housing.

    Args:
        points: ``[28928, 3]`` in m in the sensor frame, in firing order, NaN for misses: a scan of
            `uavrl.envs.lidar.Lidar.scan`, or ``point_cloud`` of the environment.
        stamp: time of the first firing in s; packets carry what of it is past the full hour.

    Returns:
        76 packets of 1,206 bytes each.

    Raises:
        UavrlError: for points of another shape.

    Examples:
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> packets = encode_scan(3.0 * firing_directions())
        >>> len(packets), {len(packet) for packet in packets}, packets[0][-2:].hex()
        (76, {1206}, '3722')
    """
    points = np.asarray(points)
    if points.shape != (AZIMUTH_STEPS * _LASERS, 3):
        raise UavrlError(
            f"A scan to be written has {AZIMUTH_STEPS * _LASERS} points [P, 3] in firing order, NaN for misses, got "
            f"{list(points.shape)}: give a scan of the simulated LiDAR."
        )
    rays = np.full((PACKETS * BLOCKS * CHANNELS, 3), np.nan, np.float32)
    rays[: len(points)] = points
    return _packed(_blocks(rays, 0), stamp + np.arange(PACKETS) * PACKET_TIME)


class PacketStream:
    """The packets of a VLP-16 that turns on and on: one of them may end a turn and begin the next.

    Examples:
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> stream, turn = PacketStream(), 3.0 * firing_directions()
        >>> [len(stream.add(turn, 0, 0.1 * number)) for number in range(3)]  # 904 blocks in a turn, 12 in a packet
        [75, 75, 76]
    """

    def __init__(self) -> None:
        self._kept: np.ndarray = np.zeros(0, _BLOCK)
        self._times: np.ndarray = np.zeros(0)

    def add(self, points: np.ndarray, first: int, begun: float) -> list[tuple[float, bytes]]:
        """Takes in what some rays have met; gives the packets that are full, each with the time of its end in s.

        Args:
            points: ``[P, 3]``, as of :func:`encode_scan`: those of whole blocks of 32 rays.
            first: number of the first ray in its turn.
            begun: when the turn began, s.
        """
        blocks = _blocks(points, first // CHANNELS)
        times = begun + (first // CHANNELS + np.arange(len(blocks))) * _BLOCK_TIME
        blocks, times = np.concatenate([self._kept, blocks]), np.concatenate([self._times, times])
        full = len(blocks) // BLOCKS * BLOCKS
        self._kept, self._times = blocks[full:], times[full:]
        ends = times[BLOCKS - 1 : full : BLOCKS] + _BLOCK_TIME
        return list(zip(ends.tolist(), _packed(blocks[:full], times[:full:BLOCKS]), strict=True))


def _blocks(points: np.ndarray, first: int) -> np.ndarray:
    """The blocks of points ``[B * 32, 3]``, whose first one is a turn's block of that number."""
    with np.errstate(over="ignore", invalid="ignore"):
        ranges = np.sqrt((points.astype(np.float64) ** 2).sum(-1))
        steps = np.round(ranges / STEP)
        steps = np.where((ranges > NEAREST_RETURN) & (steps < 2**16), steps, 0).astype("<u2").reshape(-1, CHANNELS)
    blocks = np.zeros(len(steps), _BLOCK)
    step = np.degrees(AZIMUTH_STEP) * CHANNELS / _LASERS
    blocks["flag"] = FLAG
    blocks["azimuth"] = np.round((first + np.arange(len(steps))) * step * 100).astype(np.int64) % FULL_TURN
    blocks["returns"]["distance"] = steps
    blocks["returns"]["reflectivity"] = np.where(steps, _REFLECTIVITY, 0)
    return blocks


def _packed(blocks: np.ndarray, times: np.ndarray) -> list[bytes]:
    """Packets of 12 ``blocks`` each, whose first rays were fired at ``times`` in s."""
    packets = np.zeros(len(times), PACKET)
    packets["blocks"] = blocks.reshape(-1, BLOCKS)
    packets["time"] = np.round(times * 1e6).astype(np.int64) % HOUR
    packets["mode"], packets["product"] = STRONGEST, PRODUCTS["VLP16"]
    return [packet.tobytes() for packet in packets]


def decode_vlp16(packets: list[bytes]) -> np.ndarray:
    """The returns of single-return VLP-16 packets, ``float32 [P, 3]`` in m in the sensor frame.

    For machines for which there is no `velodyne-decoder`, and to the same result: its azimuths are rounded to 0.01°.
    All beams leave one point, as in the simulator; in the device their origins lie up to 11 mm apart.

    Args:
        packets: of 1,206 bytes each, in the order in which they were sent.

    Examples:
        >>> from uavrl_onboard.lidar.vlp16 import firing_directions
        >>> points = decode_vlp16(encode_scan(3.0 * firing_directions()))
        >>> points.shape, [round(float(at), 2) + 0.0 for at in points[0]]
        ((28928, 3), [2.9, 0.0, -0.78])
    """
    blocks = np.frombuffer(b"".join(packets), PACKET)["blocks"]
    azimuth = blocks["azimuth"].astype(np.float64)  # [N, 12]
    rate = (azimuth[:, -1] - azimuth[:, 0]) % FULL_TURN / ((BLOCKS - 1) * _BLOCK_TIME)
    within = (CYCLE * np.arange(CHANNELS // _LASERS)[:, None] + LASER_INTERVAL * np.arange(_LASERS)).ravel()
    azimuth = np.radians((azimuth[:, :, None] + rate[:, None, None] * within) / 100)  # [N, 12, 32]
    elevation = np.radians(np.tile(LASER_ELEVATIONS, CHANNELS // _LASERS))
    distance = blocks["returns"]["distance"] * STEP
    hit = distance > NEAREST_RETURN
    azimuth, distance = azimuth[hit], distance[hit]
    elevation = np.broadcast_to(elevation, hit.shape)[hit]
    return spherical(-azimuth, elevation, distance).astype(np.float32)
