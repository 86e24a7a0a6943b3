"""The frames of clouds of points: a policy needs them in the sensor's own frame, which moves with the vehicle."""

from __future__ import annotations

WORLD = frozenset({"earth", "map", "odom", "world", "camera_init"})
"""Names of frames that are fixed to the world: those of REP 105, a simulator's, and that of LOAM and FAST-LIO."""
OPTICAL = ("_optical_frame", "_optical")
"""Endings of a camera's frames in REP 103, whose z points ahead, x to the right and y down."""


class CloudFrame:
    """Checks the ``frame_id`` of one sensor's clouds.

    Examples:
        >>> frame = CloudFrame()
        >>> frame.refusal("velodyne"), frame.refusal("velodyne", world="odom")
        ('', '')
        >>> frame.refusal("ouster")
        "their frame changed from velodyne to ouster, and one sensor's does not: give the topic of one driver"
    """

    def __init__(self) -> None:
        self._first: str | None = None

    def refusal(self, frame_id: str, world: str = "") -> str:
        """Return why a cloud is not one of this sensor in its own frame, as a sentence's second half; "" where it is.

        Args:
            frame_id: of the cloud's header.
            world: frame in which the vehicle's odometry has its position; "" where that is not known.
        """
        name = frame_id.strip("/")
        if name and (name in WORLD or name == world.strip("/")):
            return (
                f"they are in the frame {name}, which is fixed to the world and not to the sensor, as a SLAM program "
                "publishes them (FAST-LIO's /cloud_registered): give the topic of the LiDAR's driver"
            )
        if name.endswith(OPTICAL):
            return (
                f"they are in the frame {name}, a camera's, whose z points ahead (REP 103): publish them in a frame "
                "whose x points ahead, y to the left and z up"
            )
        self._first = name if self._first is None else self._first
        if name != self._first:
            before, after = self._first or "none", name or "none"
            return (
                f"their frame changed from {before} to {after}, and one sensor's does not: give the topic of one driver"
            )
        return ""
