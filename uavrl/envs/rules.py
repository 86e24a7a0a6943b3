"""The settings that all worlds share, and the one function that makes a world of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from uavrl.envs.limits import require_finite, whole
from uavrl.envs.terrain import HeightField
from uavrl.envs.traps import Trap
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.vehicle import VEHICLE

LARGEST_PLACE = 200_000.0  # m³ up to the ceiling: building it takes 2.4 GB, and some 20 s
LARGEST_WORLD = 500_000.0  # m³ of all places together
LARGEST = {
    "ceiling": 100.0,
    "goal_radius": 100.0,
    "min_clearance": 100.0,
    "uav_radius": 10.0,
    "traps": 20,
    "planes": 100,
    "plane_speed": 100.0,
    "plane_wingspan": 20.0,
}


class Standing(Protocol):
    """Something that stands in a place, in the place's frame."""

    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def mesh(self) -> Mesh: ...  # noqa: D102


class Solid(NamedTuple):
    """Triangles of one kind; each kind has a colour in a replay."""

    kind: str
    mesh: Mesh


class Scene(NamedTuple):
    """What there is in one place, in its own frame: x and y from its middle, z from its floor, in m.

    Attributes:
        obstacles: All triangles but those of the ground.
        size: Lengths along x and y of the area in which episodes begin and end. This is the ``size`` of the world, by
            which places are laid out.
        ground: The ground; None where the obstacles hold it, and the floor is at z = 0.
        margin: How far beyond that area a vehicle may fly; the ground reaches as far.
        traps: Of a valley.
        is_fine: Whether its triangles are short or few already; long ones of others are cut up before the free space is
            measured.
    """

    obstacles: Sequence[Standing]
    size: tuple[float, float]
    ground: HeightField | None = None
    margin: float = 0.0
    traps: Sequence[Trap] = ()
    is_fine: bool = False


@dataclass
class WorldRules:
    """What all worlds have in common; each kind of world adds its own settings and :meth:`scene`.

    A world of your own is a dataclass that derives from this one and has a ``scene``. Free space, tasks, lanes of
    planes and bounds follow from the scene's triangles.

    Args:
        seeds: One place per seed.
        size: Extent of a place along x and y in m.
        flight_level: Height in m (world z) at which episodes start.
        ceiling: Height above the ground in m at which an episode ends; the goal cylinder reaches up to it.
        goal_radius: Radius of the goal cylinder in m.
        min_goal_distance: Least horizontal distance from start to goal in m.
        min_clearance: Least distance in m from start and goal, at flight level, to the geometry.
        uav_radius: Radius in m of a ball around the UAV; corridors are wide enough for it.
        planes: Number of planes per place; 3 in the thesis's dynamic environment.
        plane_speed: Least and greatest speed of a plane in m/s.
        plane_wingspan: Wingspan of a plane in m.
        plane_keep_out: Least distance in m from a start to a plane. Where the planes leave no such place for a moment,
            the start has two thirds of it or more.
    """

    NAMED: ClassVar[bool] = True  # whether a yaml file names the class by its _target_
    VARIES: ClassVar[bool] = True  # whether another seed is another place
    REMEDY: ClassVar[str] = "enlarge size, or lower min_clearance or min_goal_distance"

    seeds: tuple[int, ...] = (0,)
    size: tuple[float, float] = (40.0, 30.0)
    flight_level: float = VEHICLE.flight_level
    ceiling: float = 5.0
    goal_radius: float = 1.0
    min_goal_distance: float = 10.0
    min_clearance: float = 1.5
    uav_radius: float = VEHICLE.radius
    planes: int = 0
    plane_speed: tuple[float, float] = (3.0, 4.0)
    plane_wingspan: float = 1.2
    plane_keep_out: float = 6.0

    def __post_init__(self) -> None:
        """Refuses values that make no world."""
        for name in ("seeds", "size", "plane_speed"):
            if not np.iterable(getattr(self, name)):
                raise UavrlError(f"{name} takes a list of numbers, got {getattr(self, name)!r}.")
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.seeds:
            raise UavrlError("seeds takes one whole number per valley, got none; pass (0,) for one.")
        object.__setattr__(self, "seeds", tuple(whole("seeds", seed) for seed in self.seeds))
        own = [each.name for each in fields(WorldRules) if each.name != "seeds"]
        require_finite(self, own)
        if len(self.size) != 2:
            raise UavrlError(f"size takes two lengths in metres, got {self.size}; pass (40.0, 30.0) for 1200 m².")
        require_positive(
            self, "flight_level", "ceiling", "goal_radius", "uav_radius", "plane_wingspan", "size", "plane_speed"
        )
        object.__setattr__(self, "planes", whole("planes", self.planes))
        for name in ("min_goal_distance", "min_clearance", "plane_keep_out"):
            if not getattr(self, name) >= 0:
                raise UavrlError(f"{name} must not be negative, got {getattr(self, name)}; pass 0 to go without.")
        if len(self.plane_speed) != 2 or self.plane_speed[0] > self.plane_speed[1]:
            raise UavrlError(
                f"plane_speed takes the least and the greatest speed, got {self.plane_speed}; pass (2.5, 4.0)."
            )
        if self.flight_level >= self.ceiling:
            raise UavrlError(
                f"flight_level must be below the ceiling of {self.ceiling} m, got {self.flight_level} m; raise ceiling."
            )
        self._check_size()

    def scene(self, number: int) -> Scene:
        """What there is in the place of ``seeds[number]``; the same at each call.

        Args:
            number: Among ``seeds``.
        """
        raise NotImplementedError(f"{type(self).__name__} makes no world: give it a method scene(number).")

    def map_rules(self, number: int) -> Mapping[str, Any] | None:
        """What the map of a place depends on, beside the code; None where its triangles have to tell."""
        return None

    def without_tasks(self, seed: int, scene: Scene, free: float) -> str:
        """Tells that a place has no tasks.

        Args:
            seed: Of the place.
            scene: What there is in it.
            free: Area in m² at the flight level that a vehicle can fly in.
        """
        return (
            f"A world needs a start and a goal {self.min_goal_distance} m apart, {self.min_clearance} m clear of "
            f"geometry and joined by a free corridor, but seed {seed} has none in {scene.size} m, where {free:.0f} m² "
            f"are free at {self.flight_level} m; {self.REMEDY}."
        )

    def pitch(self, gap: float) -> np.ndarray:
        """How far the middles of places are apart along x and y ``[2]``, in m, with a gap between their borders."""
        return np.array(self.size) + gap

    def own_rules(self) -> dict[str, Any]:
        """The shared settings that the map of a place depends on."""
        names = ("size", "flight_level", "ceiling", "min_goal_distance", "min_clearance", "uav_radius")
        return {
            **{name: getattr(self, name) for name in names},
            "wingspan": self.plane_wingspan if self.planes else 0.0,
        }

    def _check_size(self) -> None:
        """Refuses worlds that would take many minutes to build, or more memory than there is."""
        for name, most in LARGEST.items():
            value = getattr(self, name, 0)
            if (max(value) if isinstance(value, tuple) else value) > most:
                raise UavrlError(f"{name} must be at most {most:g}, got {value}; lower it.")
        volume = self.size[0] * self.size[1] * max(self.ceiling, 1.0)
        for total, most, of in (
            (volume, LARGEST_PLACE, "a valley"),
            (volume * len(self.seeds), LARGEST_WORLD, f"{len(self.seeds)} valleys together"),
        ):
            if total > most:
                raise UavrlError(
                    f"size and ceiling must make at most {most:,.0f} m³ of {of}, got {total:,.0f} m³; lower size or "
                    "ceiling, or give fewer seeds."
                )


def require_positive(config: object, *names: str) -> None:
    """Refuses lengths and speeds that are not above 0."""
    for name in names:
        if not np.all(np.asarray(getattr(config, name)) > 0):
            raise UavrlError(f"{name} must be above 0, got {getattr(config, name)}; give it in metres (or m/s).")
