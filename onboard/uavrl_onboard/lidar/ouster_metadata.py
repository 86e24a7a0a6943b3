"""What an Ouster sensor says of itself: the metadata that its packets are read by, with `ouster-sdk`."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.libraries import needed

UNSEEN = 30.0  # degrees of the horizon that may be missing: a policy takes what is not seen for free
_LARGEST = 2**20  # bytes of a file of metadata; sensors send 10 kB
_MOST_COLUMNS, _MOST_BEAMS, _MOST_IN_PACKET = 4096, 256, 64
_MOST = {"columns_per_frame": _MOST_COLUMNS, "pixels_per_column": _MOST_BEAMS, "columns_per_packet": _MOST_IN_PACKET}
_UNREAD = ("zone_set", "user_data")  # which may hold archives and texts of any size
_FARTHEST_ORIGIN = 0.2  # m, of a beam from the middle of its sensor
_UNIT = 1e-3  # m, of ranges
_PORT = 7502  # of UDP, where the metadata names none


class OusterFormat(NamedTuple):
    """The format of one sensor's packets, and where its beams point."""

    name: str  #: such as ``"OS-0-32-U1"``
    serial: int  #: 0 where the metadata does not say
    port: int  #: of UDP to which it sends
    packets: Any  #: `ouster.sdk.core.PacketFormat`
    directions: np.ndarray  #: ``float32 [H, W, 3]``, unit vectors of each beam in each column, in the sensor frame
    origins: np.ndarray  #: ``float32 [H, W, 3]``, m, where they begin
    window: np.ndarray  #: ``bool [W]``, the columns that the sensor is set to send
    returns: tuple[str, ...]  #: names of the fields with the range of each return


@cache
def sdk() -> Any:
    """Return `ouster.sdk.core`, which is told to print nothing."""
    core = needed("ouster.sdk.core", "Reading the packets of an Ouster", "ouster")
    core.init_logger("off")
    return core


def read_metadata(path: Path) -> OusterFormat:
    """Read a file of metadata as the sensor gives it (``/api/v1/sensor/metadata``), or as `ouster-cli` writes it.

    The frame of directions and origins is the sensor's (x away from its connector, y left, z up), moved up to the
    point around which its beams turn.

    Raises:
        UavrlError: for a file that is none, one of a sensor that cannot be read, and if `ouster-sdk` is not installed.
    """
    core = sdk()
    try:
        info = core.SensorInfo(_read(path))
        packets = core.PacketFormat(info)
        lut = core.XYZLut(info, False)
    except UavrlError:
        raise
    except Exception as error:  # the SDK raises errors of several kinds
        raise _refused(path, _reason(error)) from error
    fields = set(packets.fields)
    returns = tuple(name for name in ("RANGE", "RANGE2") if name in fields)
    columns, beams = info.format.columns_per_frame, info.format.pixels_per_column
    shape = beams, columns, 3
    directions = np.asarray(lut.direction).reshape(shape) / _UNIT
    origins = np.asarray(lut.offset).reshape(shape) - info.lidar_to_sensor_transform[:3, 3] * _UNIT
    if not returns:
        raise _refused(path, f"its packets, of the profile {packets.udp_profile_lidar}, hold no ranges")
    if not _are_beams(directions, origins):
        raise _refused(path, "its angles or transforms describe no beams")
    first, last = info.format.column_window
    window = (np.arange(columns) - first) % columns <= (last - first) % columns
    if 360.0 * (~window).mean() > UNSEEN:
        raise UavrlError(
            f"The azimuth window in {path} covers only {360 * window.mean():.0f}°, and a policy treats a sector "
            "without returns as free space: set the sensor's azimuth_window to [0, 360000] and save its metadata again."
        )
    packed = directions.astype(np.float32), origins.astype(np.float32), window
    name, port = str(info.prod_line) or "Ouster", int(info.config.udp_port_lidar or _PORT)
    return OusterFormat(name, int(info.sn), port, packets, *packed, returns)


def _read(path: Path) -> str:
    """The text of a file of metadata without what is not read, if its numbers are those of a sensor."""
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
    except OSError as error:
        raise UavrlError(f"The metadata {path} cannot be read ({error.strerror}): give metadata=FILE.") from error
    if len(content) > _LARGEST:
        raise _refused(path, f"it has more than {_LARGEST:,} bytes")
    try:
        told = json.loads(content)
        if not isinstance(told, dict):
            raise TypeError("it holds no names")
        kept = {name: value for name, value in told.items() if name not in _UNREAD}
        for section in ("lidar_data_format", "data_format"):
            form = kept.get(section, {})
            for name, most in _MOST.items():
                value = form.get(name, 1)
                if type(value) is not int or not 0 < value <= most:
                    raise ValueError(f"{name} is {value!r:.40}, and must be in [1, {most}]")
        return json.dumps(kept, allow_nan=False)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise _refused(path, _reason(error)) from error


def _are_beams(directions: np.ndarray, origins: np.ndarray) -> bool:
    """Whether the directions ``[..., 3]`` are unit vectors that begin within a sensor."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths, far = np.linalg.norm(directions, axis=-1), np.linalg.norm(origins, axis=-1)
    return bool((np.abs(lengths - 1.0) < 1e-3).all() and (far < _FARTHEST_ORIGIN).all())


def _refused(path: Path, reason: str) -> UavrlError:
    return UavrlError(
        f"{path} is no metadata of an Ouster that can be read ({reason}): save the sensor's own with "
        "curl http://SENSOR/api/v1/sensor/metadata."
    )


def _reason(error: BaseException) -> str:
    """What an error says, in one line."""
    said = " ".join(str(error).split()).removeprefix("ERROR: Critical Metadata Issues Exist: ")
    return (said or type(error).__name__)[:200].rstrip(". ")
