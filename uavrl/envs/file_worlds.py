"""Worlds from a file: a triangle mesh, or a point cloud whose voxels are solid."""

import logging
import math
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from uavrl.envs.limits import require_finite, require_number, whole
from uavrl.envs.mesh import cut_up, edge_lengths
from uavrl.envs.rules import LARGEST_PLACE, Scene, Solid, WorldRules, require_positive
from uavrl.envs.shape_file import (
    COLUMN,
    Surface,
    Up,
    area_across,
    columns_along,
    floor_of,
    other_up,
    read_file,
    require_file,
    sampled,
    to_metres,
)
from uavrl.envs.shape_reader import CLOUDS, MESHES
from uavrl.envs.voxels import occupied, voxel_mesh
from uavrl.errors import UavrlError
from uavrl_onboard.mesh import Mesh

log = logging.getLogger(__name__)
MOST_TRIANGLES = 2_000_000
AROUND = 20.0  # m around the part that is flown in from which triangles are kept: the LiDAR sees them
PART = 100  # m, sides of the part that is proposed of a file that is too large
AS_GOOD = 0.95  # of the most ground that a part covers: such a part is as good
LONGEST_EDGE = 10.0  # m, of the pieces of triangles that reach farther
EMPTY = 1.0  # m, that a part may reach beyond the file before it is told
LEAST_VOXEL, LARGEST_VOXEL = 0.02, 5.0  # m


@dataclass
class FileWorld(WorldRules):
    """What worlds from a file have in common.

    The place's frame has its origin in the middle of the file's extent, or of the part that is chosen, at the floor.

    Args:
        file: The file.
        scale: Factor from the file's unit to metres.
        up: The file's axis that points up: x, y or z. None: y for GLB, as its standard says, and z for all others.
        floor: Height of the floor in the file, in m. None: the median height of the lowest surfaces, or, in a solid
            such as a block of terrain with a base, of the lowest surfaces that face up.
        size: Extent in m of the part to fly in, along the same axes as ``centre``; None: all.
        centre: Middle of that part in m, along the file's x and y, y and z with ``up="x"``, or z and x with ``up="y"``.
            None: the middle of the file.
        **kwargs: As in :class:`uavrl.envs.rules.WorldRules`.
    """

    file: str = ""
    scale: Annotated[float, Field(gt=0)] = 1.0
    up: Up | None = None
    floor: float | None = None
    size: tuple[float, float] | None = None  # type: ignore[assignment]
    centre: tuple[float, float] | None = None

    VARIES: ClassVar[bool] = False
    SUFFIXES: ClassVar[tuple[str, ...]] = ()
    KIND: ClassVar[str] = "mesh"  # whose colour a replay shows
    FEWER: ClassVar[str] = "decimate it"

    def __post_init__(self) -> None:
        """Refuses settings that name no place."""
        chosen = self.size
        if chosen is None:
            object.__setattr__(self, "size", (1.0, 1.0))
        super().__post_init__()
        if chosen is None:
            object.__setattr__(self, "size", None)
        require_number(self, "scale")
        require_positive(self, "scale")
        if self.floor is not None:
            require_number(self, "floor")
        if self.centre is not None:
            if isinstance(self.centre, str) or not np.iterable(self.centre) or len(tuple(self.centre)) != 2:
                raise UavrlError(f"centre takes x and y in metres, got {self.centre!r}.")
            require_finite(self, ["centre"])
        if self.up not in (None, "x", "y", "z"):
            raise UavrlError(f"up must be x, y, z or None, got {self.up!r}.")
        if not self.file:
            raise UavrlError("A world from a file needs one: write env.world.file=FILE.")
        if not isinstance(self.file, str | os.PathLike):
            raise UavrlError(f"file takes the path of a file, got {self.file!r}: write env.world.file=FILE.")
        if len(self.seeds) != 1:
            raise UavrlError(f"A file is one place, and seeds are {list(self.seeds)}: give one, or leave them out.")
        object.__setattr__(self, "file", str(Path(self.file).expanduser().absolute()))

    @property
    def upwards(self) -> Up:
        """The file's axis that points up."""
        return self.up or ("y" if self.file.lower().endswith(".glb") else "z")

    def pitch(self, gap: float) -> np.ndarray:
        """Of the one place."""
        return np.zeros(2)

    def shape(self, path: Path) -> tuple[np.ndarray, Surface]:
        """Corners ``[F, 3, 3]`` of the file's triangles in metres with z up, and points on its surface."""
        raise NotImplementedError(f"{type(self).__name__} reads no file.")

    def scene(self, number: int) -> Scene:
        """The file's triangles, in the place's frame."""
        return self._scene

    @cached_property
    def _scene(self) -> Scene:
        path = require_file(self.file, self.SUFFIXES)
        corners, surface = self.shape(path)
        flat = surface.points[:, :2]
        low, high = flat.min(0), flat.max(0)
        size = (float(high[0] - low[0]), float(high[1] - low[1])) if self.size is None else self.size
        middle = (low + high) / 2 if self.centre is None else np.array(self.centre)
        if size[0] * size[1] * max(self.ceiling, 1.0) > LARGEST_PLACE:
            most = LARGEST_PLACE / max(self.ceiling, 1.0)
            (x, y), (length, width) = best_covered(flat, min(PART, math.floor(math.sqrt(most))))
            raise UavrlError(
                f"{path} is {size[0]:,.0f} × {size[1]:,.0f} m, and at most {most:,.0f} m² are flown in under a ceiling "
                f"of {self.ceiling:g} m: choose a part, for example one that it covers well, with "
                f"env.world.size=[{length:.0f},{width:.0f}] and env.world.centre=[{x:.0f},{y:.0f}]."
            )
        inside = (np.abs(flat - middle) <= np.array(size) / 2).all(1)
        if not inside.any():
            raise UavrlError(
                f"{path} has nothing in {size[0]:g} × {size[1]:g} m around {middle.round(1).tolist()}: it reaches from "
                f"{low.round(1).tolist()} to {high.round(1).tolist()}; choose another env.world.centre."
            )
        _tell_empty(path, corners, middle, size)
        floor, lowest = floor_of(surface.only(inside)) if self.floor is None else (self.floor, self.floor)
        corners = _within(corners - [*middle, floor], np.array(size) / 2 + AROUND)
        if len(corners) > MOST_TRIANGLES:
            raise UavrlError(
                f"{path} makes {len(corners):,} triangles, and at most {MOST_TRIANGLES:,} are taken: "
                f"{self.FEWER}, or choose a part with env.world.size and env.world.centre."
            )
        log.info(
            "%s: %s triangles, %.1f × %.1f m around [%.1f,%.1f]; the file reaches from [%.1f,%.1f] to [%.1f,%.1f], and "
            "altitude 0 is at %.2f m of it.",
            path.name,
            f"{len(corners):,}",
            *size,
            *middle,
            *low,
            *high,
            floor,
        )
        if floor > lowest:
            log.warning(
                "%s looks like a closed solid, so its top is taken as the ground. If vehicles are to fly inside, as "
                "in a hall, write env.world.floor=%.2f.",
                path.name,
                lowest,
            )
        return Scene([Solid(self.KIND, _mesh(corners))], size)

    def _upright(self, path: Path, seen: np.ndarray, than: float) -> str | None:
        """Tells of a file of which more is seen along another axis than along the one that is taken as up."""
        if self.up is not None or not (other := other_up(seen, than, self.upwards)):
            return None
        return (
            f"{path} has most of its surface upright, as if another axis pointed up than {self.upwards}: write "
            f"env.world.up={other}, or env.world.up={self.upwards} if it is right."
        )

    def without_tasks(self, seed: int, scene: Scene, free: float) -> str:
        """Tells what there is at the flight level."""
        (solid,) = scene.obstacles
        low, high = solid.mesh.vertices[:, 2].min(), solid.mesh.vertices[:, 2].max()
        return (
            f"{self.file} has no start and goal {self.min_goal_distance} m apart, {self.min_clearance} m clear of "
            f"geometry and joined by a free corridor: it reaches from {low:.1f} to {high:.1f} m above its floor over "
            f"{scene.size[0]:.1f} × {scene.size[1]:.1f} m, and {free:.0f} m² are free at the flight level of "
            f"{self.flight_level} m; check env.world.up, floor and scale, or lower flight_level, min_clearance or "
            "min_goal_distance."
        )


@dataclass
class MeshConfig(FileWorld):
    """A triangle mesh: STL, OBJ, PLY or GLB, read by trimesh. Its surfaces are seen and touched from both sides.

    Args:
        **kwargs: As in :class:`FileWorld`.
    """

    SUFFIXES = MESHES

    def shape(self, path: Path) -> tuple[np.ndarray, Surface]:
        """The mesh's triangles."""
        points, triangles = read_file(path, self.scale)
        if not len(triangles):
            clouds = "use env=cloud" if path.suffix.lower() in CLOUDS else "convert it to PLY or XYZ, and use env=cloud"
            instead = f"for a point cloud, {clouds}" if len(points) else "name another file"
            raise UavrlError(f"{path} has {len(points):,} points and no triangles: {instead}.")
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise UavrlError(f"{path} has triangles whose corners are not in it: export it again.")
        used = points[triangles]
        if bad := int((~np.isfinite(used)).any((1, 2)).sum()):
            told = f"{bad:,} of {len(used):,} triangles have corners that are no finite numbers"
            raise UavrlError(f"{path}: {told}: repair it, or export it again.")
        used = to_metres(used.reshape(-1, 3), path, self.scale, self.upwards).reshape(-1, 3, 3)
        seen = area_across(used)
        if upright := self._upright(path, seen, np.sort(seen)[1]):
            raise UavrlError(upright)
        return used, sampled(used)


@dataclass
class CloudConfig(FileWorld):
    """A point cloud: PLY, PCD, XYZ, NPY or NPZ. Voxels that hold enough points are solid, all others are free.

    What the scan has not seen is free as well: choose a part that it has covered.

    Args:
        voxel: Side of a voxel in m.
        min_points: Points that make a voxel solid.
        **kwargs: As in :class:`FileWorld`.
    """

    voxel: Annotated[float, Field(ge=LEAST_VOXEL, le=LARGEST_VOXEL)] = 0.2
    min_points: int = 2

    SUFFIXES = CLOUDS
    KIND = "cloud"
    FEWER = "enlarge env.world.voxel"

    def __post_init__(self) -> None:
        """Refuses settings that make no voxels."""
        super().__post_init__()
        require_number(self, "voxel", LEAST_VOXEL, LARGEST_VOXEL)
        object.__setattr__(self, "min_points", whole("min_points", self.min_points, 1))

    def shape(self, path: Path) -> tuple[np.ndarray, Surface]:
        """The faces of solid voxels, and the middles of their tops."""
        points, triangles = read_file(path, self.scale)
        if len(triangles):
            raise UavrlError(f"{path} has {len(triangles):,} triangles, and a point cloud has none: use env=mesh.")
        points = points[np.isfinite(points).all(1)]  # sensors write what they missed as NaN
        if not len(points):
            raise UavrlError(f"{path} has no point whose numbers are finite: name another file.")
        points = to_metres(points, path, self.scale, self.upwards)
        seen = columns_along(occupied(points, COLUMN, 1))
        if upright := self._upright(path, seen, seen[2]):
            log.warning(upright)  # a street between high houses looks so, too
        solid = occupied(points, self.voxel, self.min_points)
        if not len(solid):
            raise UavrlError(
                f"{path} has {len(points):,} points, and none of its voxels of {self.voxel} m holds "
                f"{self.min_points}: enlarge env.world.voxel, or lower env.world.min_points."
            )
        return voxel_mesh(solid, self.voxel), Surface((solid + np.array((0.5, 0.5, 1.0))) * self.voxel)


def best_covered(points: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """The middle and the size of a square in which points cover most of the ground.

    Of squares that are nearly as good, it is the one nearest to the middle of all points. It ends where they end.

    Args:
        points: On surfaces, seen from above, ``[P, 2]`` in m.
        side: Of the square in m.

    Examples:
        A corridor of 300 m, and a yard at its end:

        >>> x, y = np.mgrid[0:301, 0:5], np.mgrid[250:301, 0:51]
        >>> best_covered(np.concatenate([x.reshape(2, -1).T, y.reshape(2, -1).T]), 50)
        (array([273.,  25.]), array([50., 50.]))
    """
    low, high = points.min(0), points.max(0)
    cell = max(1.0, (high - low).max() / 1000)
    seen = ((points - low) / cell).astype(int)
    wide = np.minimum(np.maximum(np.round(side / cell), 1), seen.max(0) + 1).astype(int)  # in cells
    covered = np.zeros(seen.max(0) + 2)
    covered[tuple(seen.T + 1)] = 1.0
    total = covered.cumsum(0).cumsum(1)
    (w, h) = wide
    inside = total[w:, h:] - total[:-w, h:] - total[w:, :-h] + total[:-w, :-h]
    good = np.argwhere(inside >= AS_GOOD * inside.max())
    middles = low + cell * (good + wide / 2)
    nearest = ((middles - (low + high) / 2) ** 2).sum(1).argmin()
    return middles[nearest], np.minimum(cell * wide, side)


def _tell_empty(path: Path, corners: np.ndarray, middle: np.ndarray, size: tuple[float, float]) -> None:
    """Warns of a part that reaches beyond the triangles ``[F, 3, 3]`` of a file."""
    low, high, half = corners.min((0, 1))[:2], corners.max((0, 1))[:2], np.array(size) / 2
    beyond = np.maximum(low - (middle - half), 0) + np.maximum(middle + half - high, 0)
    if beyond.max() > EMPTY:
        log.warning(
            "%s reaches from [%.1f,%.1f] to [%.1f,%.1f], and env.world.size=[%g,%g] around [%.1f,%.1f] is larger: the "
            "rest is empty space without ground.",
            path,
            *low,
            *high,
            *size,
            *middle,
        )


def _within(corners: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Those triangles ``[F, 3, 3]`` that lie within a rectangle of half lengths ``half [2]``; long ones are cut."""

    def outside(pieces: np.ndarray) -> np.ndarray:
        flat = pieces[..., :2]
        return ((flat.max(1) < -half) | (flat.min(1) > half)).any(1)

    corners = corners[~outside(corners)]
    reach = (np.abs(corners[..., :2]) > half).any((1, 2))
    pieces = cut_up(corners[reach], lambda each: (edge_lengths(each).max(1) <= LONGEST_EDGE) | outside(each))
    return np.concatenate([corners[~reach], pieces[~outside(pieces)]])


def _mesh(corners: np.ndarray) -> Mesh:
    """A mesh of triangles ``[F, 3, 3]``, whose corners are shared where they are the same."""
    points, which = np.unique(corners.reshape(-1, 3).astype(np.float32), axis=0, return_inverse=True)
    return Mesh(points, which.reshape(-1, 3))
