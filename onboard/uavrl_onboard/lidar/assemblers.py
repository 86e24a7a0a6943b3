"""What makes scans of packets, chosen by what the user says of the sensor."""

from __future__ import annotations

from pathlib import Path

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.ouster import OusterAssembler
from uavrl_onboard.lidar.scans import Assembler, ScanAssembler


def make_assembler(model: str | None, product: int | None = None, metadata: str | Path | None = None) -> Assembler:
    """Return what makes scans of the packets of a Velodyne, or of the Ouster that a file of metadata describes.

    Raises:
        UavrlError: for an unknown model, for metadata that cannot be read, and for both.
    """
    if metadata is None:
        return ScanAssembler(model, product)
    if model is not None or product is not None:
        raise UavrlError(
            "metadata=FILE describes an Ouster, and model and product describe a Velodyne: drop metadata, or drop "
            "model and product."
        )
    return OusterAssembler(metadata)
