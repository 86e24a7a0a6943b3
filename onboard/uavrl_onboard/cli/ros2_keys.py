"""The keys of ROS 2, and the links, feeds and reports that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from uavrl_onboard.ranges import Text

if TYPE_CHECKING:
    from uavrl_onboard.flight.interfaces import VehicleLink
    from uavrl_onboard.flight.limits import SafetyLimits
    from uavrl_onboard.policy.contract import Contract
    from uavrl_onboard.ros2.px4 import Px4Ros2
    from uavrl_onboard.ros2.reports import Ros2Reports
    from uavrl_onboard.ros2.vehicle import Ros2Scans, Ros2Vehicle

ROS2 = "ros2:"  # how addresses of ROS 2 begin


@dataclass
class Ros2Config:
    """How set-points are sent to a vehicle at ``autopilot=ros2:///TOPIC``, and what is published about the flight.

    Args:
        kind: type of the set-points: twist, twist_stamped, or px4, whose topics begin with autopilot=ros2:///fmu
        setpoints: topic of a twist or twist_stamped
        frame_id: frame of a twist_stamped
        diagnostics: publish the state of the flight, the LiDAR and the vehicle to /diagnostics
        markers: publish goal, cells and set-point to /uavrl/markers, for RViz and Foxglove
    """

    kind: Literal["twist", "twist_stamped", "px4"] = "twist"
    setpoints: Text = "/cmd_vel"
    frame_id: Text = "base_link"
    diagnostics: bool = False
    markers: bool = False


# These need a library that few have, so they are imported where they are used.


def ros2_link(address: str, keys: Ros2Config) -> Ros2Vehicle | Px4Ros2:
    """The way to a vehicle at an address of ROS 2."""
    from uavrl_onboard.ros2.px4 import Px4Ros2
    from uavrl_onboard.ros2.vehicle import Ros2Vehicle

    if keys.kind == "px4":
        return Px4Ros2(address)
    return Ros2Vehicle(address, setpoints=keys.setpoints, kind=keys.kind, frame_id=keys.frame_id)


def ros2_feed(address: str, link: VehicleLink) -> Ros2Scans:
    """The scans of a topic, of a sensor on the vehicle."""
    from uavrl_onboard.ros2.vehicle import Ros2Scans, Ros2Vehicle

    return Ros2Scans(address, link if isinstance(link, Ros2Vehicle) else None)


def ros2_reports(
    keys: Ros2Config,
    addresses: list[str],
    link: VehicleLink,
    contract: Contract,
    goal: Sequence[float],
    radius: float,
    limits: SafetyLimits,
) -> Ros2Reports:
    """What publishes reports, in the domain of the first address of ROS 2, or else in the default one.

    Args:
        keys: which reports.
        addresses: of the vehicle and the LiDAR.
        link: to the vehicle.
        contract: of the policy.
        goal: x, y, z in the world's axes, m.
        radius: horizontal distance from the goal at which the vehicle has arrived, m.
        limits: of the safety layer.
    """
    from uavrl_onboard.ros2.dds import topic_of
    from uavrl_onboard.ros2.reports import Ros2Reports

    domain, _ = topic_of(next((each for each in addresses if each.startswith(ROS2)), f"{ROS2}///uavrl"))
    return Ros2Reports(
        domain,
        contract,
        goal,
        radius=radius,
        limits=limits,
        frame=lambda: str(getattr(link, "world_frame", "")),
        diagnostics=keys.diagnostics,
        markers=keys.markers,
    )
