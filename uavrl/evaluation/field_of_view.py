"""Which of a policy's cells a LiDAR never sees: the policy would take them for free."""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import Transform

from uavrl.config.build import TARGET, build
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.sensors import SENSORS, LidarSensor
from uavrl.errors import UavrlError
from uavrl.transforms import PointCloudReduction, RangeImage
from uavrl_onboard.perception.view import View, in_view, with_rows

BEYOND = 5.0  # degrees over the highest row, or under the lowest, from which on a training is warned
ALL_AROUND = (-180.0, 180.0)  # degrees
TRAINED_WITH = "vlp16"  # policies whose configuration does not name their sensor
_SCANS = 5  # of a pattern that changes: half a second, as much as the frames of a state

log = logging.getLogger(__name__)


def trained_sensor(config: DictConfig) -> Any:
    """Return the sensor that a run was trained with, as :func:`uavrl.envs.sensors.lidar_sensor` takes it."""
    found = OmegaConf.select(config, "perception.lidar.sensor") or TRAINED_WITH
    return OmegaConf.to_container(found) if OmegaConf.is_config(found) else found


def unseen_cells(
    perception: Mapping[str, Any], sensor: Any, packages: Iterable[str] = (), view: View | None = None
) -> tuple[list[int], np.ndarray]:
    """Return the cells in which a sensor never sees anything, and the directions ``[cells, 3]`` of all cells.

    Both are empty where a perception has no cells. Rays outside a ``view`` do not count.
    """
    reduction = _reduction(perception, packages)
    if reduction is None:
        return [], np.zeros((0, 3))
    device = LidarConfig(sensor=sensor).device
    rays = device.rays.directions[: _SCANS * device.stride].reshape(-1, 3)
    if view is not None:
        x, y, z = rays.T
        rays = rays[in_view(x, y, z, view)]
    return reduction.unseen_cells(torch.from_numpy(rays.copy())), reduction.directions().double().numpy()


def with_trained_view(
    perception: Mapping[str, Any], trained_with: Any = None, packages: Iterable[str] = ()
) -> Mapping[str, Any]:
    """Let a policy's cells read only what the sensor of its training could have seen; a run's own sensor stays.

    A sensor that looks farther up would otherwise show a ceiling in the cells of the highest row, where the policy has
    learned that a wall stands ahead. A range image is also read as far as its rows reach, where they reach farther
    than that sensor saw. Of a policy that was not trained, its rows alone count.

    Args:
        perception: validated; its ``lidar`` names the sensor.
        trained_with: the sensor of the training; None for a policy that was not trained.
        packages: that the user trusts.
    """
    lidar = perception.get("lidar")
    if not isinstance(lidar, LidarConfig):
        return perception
    known = replace(lidar, sensor=trained_with or TRAINED_WITH).device
    if lidar.device == known:
        return perception
    reduction = _reduction(perception, packages)
    view = known.field_of_view
    if isinstance(reduction, RangeImage):
        view = (
            (*ALL_AROUND, *reduction.grid.elevation)
            if trained_with is None
            else with_rows(view, reduction.grid.elevation)
        )
    elif reduction is None or trained_with is None:
        return perception
    return {**perception, "lidar": replace(lidar, trained_view=view)}


def check_field_of_view(
    perception: Mapping[str, Any],
    trained_with: Any = None,
    packages: Iterable[str] = (),
    *,
    allowed: bool = False,
) -> int:
    """Return how many cells the LiDAR never sees that the sensor of the training does; refuse them unless allowed.

    Args:
        perception: validated; its ``lidar`` names the sensor.
        trained_with: the sensor of the training; None for a policy that was not trained, for which the LiDAR is
            compared with a VLP-16 and never refused.
        packages: that the user trusts.
        allowed: whether a trained policy may fly nevertheless.

    Raises:
        UavrlError: naming the cells, and what to do.
    """
    lidar = perception.get("lidar")
    if not isinstance(lidar, LidarConfig):
        return 0
    device, known = lidar.device, replace(lidar, sensor=trained_with or TRAINED_WITH).device
    if device == known:
        return 0
    _warn_short(perception, lidar, known)
    view = with_trained_view(perception, trained_with, packages)["lidar"].trained_view
    unseen, directions = unseen_cells(perception, lidar.sensor, packages, view)
    seen_before = set(unseen) - set(unseen_cells(perception, known, packages)[0]) if unseen else set()
    if not seen_before:
        return 0
    told = f"The LiDAR {device.name} never sees {len(seen_before)} of the {len(directions)} cells"
    where = _where(directions[sorted(seen_before)])
    if trained_with is None or allowed:
        log.warning("%s %s; they read as free.", told, where)
        return len(seen_before)
    its_name = device.name if device.name in SENSORS else "FILE.yaml"
    raise UavrlError(
        f"{told} that the policy was trained to read with {known.name} {where}, so it would take them for free: choose "
        f"another env.lidar, train a policy for this one with uavrl-train env.lidar={its_name}, or fly nevertheless "
        "with allow_unseen=true."
    )


def _warn_short(perception: Mapping[str, Any], flown: LidarConfig, trained_with: LidarSensor) -> None:
    """Warn if the LiDAR reaches less far than the cells of a policy, and than that of its training does."""
    radius = perception.get("radius")
    if isinstance(radius, int | float) and flown.reach < min(float(radius), trained_with.max_range):
        log.warning(
            "The LiDAR %s reaches %g m, and the policy reads its cells up to %g m: obstacles that are farther away "
            "read as free.",
            flown.device.name,
            flown.reach,
            radius,
        )


def warn_beyond_rows(perception: Mapping[str, Any], packages: Iterable[str] = ()) -> None:
    """Warn before a training if the LiDAR sees farther up or down than the rows of the cells reach."""
    lidar, reduction = perception.get("lidar"), _reduction(perception, packages)
    if not isinstance(lidar, LidarConfig) or not isinstance(reduction, RangeImage):
        return
    (low, high), rows = lidar.device.field_of_view[2:], reduction.grid.elevation
    if low < rows[0] - BEYOND or high > rows[1] + BEYOND:
        log.warning(
            "The LiDAR %s sees from %g to %g degrees, and the rows of the cells reach from %g to %g: what lies above "
            "or below counts in the outermost rows, so a ceiling reads like a wall. perception.grid.elevation=[%g,%g] "
            "gives all of it rows of its own.",
            lidar.device.name,
            low,
            high,
            *rows,
            low,
            high,
        )


def _reduction(perception: Mapping[str, Any], packages: Iterable[str]) -> PointCloudReduction | None:
    """Return what makes the cells of a perception; None where it has none of ours."""
    state = None if perception.get(TARGET) is None else build(perception, Transform, packages=packages)
    parts = () if state is None else state.modules()
    return next((part for part in parts if isinstance(part, PointCloudReduction)), None)


def _where(directions: np.ndarray) -> str:
    """Where cells lie, in words."""
    elevation = np.degrees(np.arcsin(directions[:, 2].clip(-1, 1))).round().astype(int)
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360
    around = np.sort(azimuth)
    gaps = np.diff(around, append=around[0] + 360)
    widest = int(gaps.argmax())
    sides = ""
    if gaps[widest] > 60:  # they are not all around
        first, last = around[(widest + 1) % len(around)], around[widest]
        sides = f", from {first:.0f} to {last:.0f} degrees to the left of straight ahead"
    low, high = elevation.min(), elevation.max()
    level = f"an elevation of {low} degrees" if low == high else f"elevations from {low} to {high} degrees"
    return f"(at {level}{sides})"
