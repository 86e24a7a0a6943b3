"""Quantities that only the simulator can provide, for critics and demonstrators."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from uavrl.envs.shortest_way import ShortestWays
from uavrl.envs.simulation import Simulation
from uavrl.envs.traffic import Traffic
from uavrl_onboard.geometry import world_to_yaw

PLANES = 3  # the nearest ones
SIGHT = 20.0  # m, beyond which a plane counts as absent
FASTEST = 4.0  # m/s, by which the velocities of planes are divided
STRONGEST = 5.0  # m/s, by which the wind is divided
FARTHEST = 5.0  # m, up to which the simulation measures distances
MANY = 3.0  # dead ends, by which their number is divided


@dataclass(frozen=True)
class Quantity:
    """One privileged quantity.

    Attributes:
        signs: of its numbers in a mirror at the vehicle's side; there are as many.
        unit: of its numbers, as they are stored.
        divisor: brings it to about [-1, 1] for a network.
    """

    signs: tuple[float, ...]
    unit: str
    divisor: float = 1.0


QUANTITIES: Mapping[str, Quantity] = {
    "clearance": Quantity((1.0,), "m", FARTHEST),
    "planes": Quantity(
        (1.0, -1.0, 1.0) * 2 * PLANES,
        f"of each of {PLANES}: the direction times 1 - distance / {SIGHT:g} m, and the velocity over {FASTEST:g} m/s",
    ),
    "wind": Quantity((1.0, -1.0, 1.0), "m/s", STRONGEST),
    "way": Quantity((1.0, -1.0), "a unit vector"),
    "mapped_way": Quantity((1.0, -1.0), "a unit vector"),
    "traps": Quantity((1.0,), "a number", MANY),
}
"""``clearance``: m from the hull to the nearest thing, at most 5. ``planes``: of each of the three nearest within 20 m,
its direction times ``1 - distance / 20``, and its velocity over 4 m/s; zeros for an absent one. ``wind``: m/s, without
gusts. ``way``: the unit vector, forward and left, to the point 2 to 2.8 m ahead on the shortest path to the goal around
static obstacles, at the flight level. ``mapped_way``: the unit vector, forward and left, to the goal, or along the
quickest way through a map of what the LiDAR has shown in the episode while that is a detour of some metres
(:mod:`uavrl.envs.mapped_way`). ``traps``: how many dead ends were built into the vehicle's valley, 0 in other worlds.
The axes are forward, left and up of the vehicle, rotated by its yaw only."""


def privileged(
    names: Collection[str], simulation: Simulation, traffic: Traffic, ways: ShortestWays | None
) -> dict[str, np.ndarray]:
    """Return those of the quantities of all vehicles ``[N, ...]`` that are asked for; ``way`` needs ``ways``.

    ``mapped_way`` and ``traps`` are not among them: they take scans (:mod:`uavrl.envs.mapped_way`) and places.
    """
    found: dict[str, np.ndarray] = {}
    if "clearance" in names:
        found["clearance"] = simulation.closest_distance()
    if "wind" in names:
        found["wind"] = world_to_yaw(simulation.params.wind, simulation.yaw)
    if "planes" in names:
        found["planes"] = nearest_planes(simulation.position, simulation.yaw, traffic.positions, traffic.velocities())
    if "way" in names and ways is not None:
        found["way"] = ways.directions(simulation.position, simulation.yaw)
    return found


def as_moving_objects(told: np.ndarray) -> np.ndarray:
    """Return planes as :class:`uavrl.transforms.MotionSight` reports moving objects, ``[N, 21]``, of ``planes``.

    Examples:
        >>> told = nearest_planes(np.zeros((1, 3)), np.zeros(1), np.array([[0.0, 10.0, 0.0]]), np.array([[2.0, 0, 0]]))
        >>> as_moving_objects(told)[0, :7].tolist()
        [0.0, 10.0, 0.0, 2.0, 0.0, 0.0, 1.0]
    """
    each = told.reshape(len(told), -1, 6)
    near = np.linalg.norm(each[..., :3], axis=-1, keepdims=True)
    positions = each[..., :3] / np.maximum(near, 1e-9) * (1 - near) * SIGHT
    objects = np.concatenate([positions, each[..., 3:] * FASTEST, near > 0], -1)
    return objects.reshape(len(told), -1)


def nearest_planes(position: np.ndarray, yaw: np.ndarray, planes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Return the directions and velocities of the planes ``[K, 3]`` nearest to vehicles ``[N, 3]``: ``[N, 18]``.

    Examples:
        >>> told = nearest_planes(np.zeros((1, 3)), np.zeros(1), np.array([[0.0, 10.0, 0.0]]), np.array([[2.0, 0, 0]]))
        >>> told[0, :7].tolist()
        [0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0]
    """
    told = np.zeros((len(position), PLANES, 6))
    offsets = planes[None] - position[:, None]
    far = np.linalg.norm(offsets, axis=-1)
    for rank, plane in enumerate(np.argsort(far, axis=1)[:, :PLANES].T):
        rows = np.arange(len(position))
        distance = far[rows, plane][:, None]
        direction = world_to_yaw(offsets[rows, plane], yaw) / np.maximum(distance, 1e-9)
        there = np.concatenate([direction * (1 - distance / SIGHT), world_to_yaw(velocities[plane], yaw) / FASTEST], -1)
        told[:, rank] = np.where(distance < SIGHT, there, 0.0)
    return told.reshape(len(position), -1)
