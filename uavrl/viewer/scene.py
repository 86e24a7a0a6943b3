"""Pictures of a valley: Embree casts the rays of a camera, and a sun gives light and shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uavrl.envs.terrain import HeightField
from uavrl.errors import extras
from uavrl.evaluation.recording import Scenery
from uavrl.viewer.colours import KINDS, OTHER_KIND
from uavrl.viewer.flight_page import above_ground
from uavrl_onboard.mesh import Mesh

with extras():
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

SUN = np.array([-0.40, -0.55, 0.73]) / np.linalg.norm([0.40, 0.55, 0.73])  # towards the sun
AMBIENT, DIFFUSE = 0.72, 0.48  # light of the sky, which comes from above, and of the sun
GROUND = ((-0.6, "#b3a77e"), (0.6, "#c9bd96"), (2.5, "#bfb598"), (7.5, "#e9e4d6"))  # heights in m and their colours
SKY, HAZE = "#9fc0dd", "#eef2f4"
HAZE_FROM, HAZE_TO = 10.0, 80.0  # m: the distances at which things begin to fade, and have faded into the haze
TEXEL, BIAS = 0.05, 0.18  # m: a cell of the map of shadows, and how far behind a lit surface a point is in shadow
TEXELS = 4096  # along each side at most: in a large world the cells are larger
EDGE = 0.04  # the relative step in distance between neighbouring pixels that is smoothed as an edge
CHUNK = 16_384  # rays that are cast at a time
SAMPLES = ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))  # where the rays of a smoothed pixel pass


def rgb(colour: str) -> np.ndarray:
    """Return a colour such as ``"#0072B2"`` as ``float32 [3]`` from 0 to 1."""
    return np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)], np.float32) / 255


@dataclass(frozen=True)
class View:
    """A camera without roll. Its rays leave from the eye; with a ``width`` in m they are parallel."""

    eye: np.ndarray
    target: np.ndarray
    angle: float = 1.08  #: horizontal field of view in rad
    width: float | None = None
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def axes(self) -> np.ndarray:
        """Return the unit vectors ``[3, 3]`` to the right, upwards and forward."""
        ahead = (self.target - self.eye) / np.linalg.norm(self.target - self.eye)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, ahead), ahead]).astype(np.float32)

    def rays(self, columns: np.ndarray, rows: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and unit directions ``float32 [R, 3]`` of the rays through pixels ``[R]`` of a picture."""
        (width, height), (right, up, ahead) = size, self.axes()
        across = np.asarray((2 * columns + 1) / width - 1, np.float32)[:, None]
        along = np.asarray((height - 2 * rows - 1) / width, np.float32)[:, None]
        eye = self.eye.astype(np.float32)
        if self.width is not None:
            origins = eye + np.float32(self.width / 2) * (across * right + along * up)
            return origins, np.broadcast_to(ahead, origins.shape)
        directions = ahead + np.float32(np.tan(self.angle / 2)) * (across * right + along * up)
        directions /= np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
        return np.broadcast_to(eye, directions.shape), directions

    def pixels(self, points: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels ``[P, 2]`` (column, row) of points ``[P, 3]`` in m, and how far they are along their rays.

        Points behind the eye are at a distance of 0.
        """
        width, height = size
        offsets = np.asarray(points, np.float32) - self.eye.astype(np.float32)
        across, along, ahead = (offsets @ axis for axis in self.axes())
        distances = np.where(ahead > 1e-3, ahead if self.width else np.linalg.norm(offsets, axis=1), 0.0)
        scale = self.width / 2 if self.width else np.tan(self.angle / 2) * np.maximum(ahead, 1e-3)
        columns, rows = (across / scale + 1) * width / 2 - 0.5, (height - along / scale * width) / 2 - 0.5
        return np.stack([columns, rows], 1), distances


@dataclass(frozen=True)
class Body:
    """The shape of something that moves, in its own axes, and the colour of each of its triangles ``[F, 3]``."""

    mesh: Mesh
    colours: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[tuple[Mesh, str]]) -> Body:
        """Return one body made of parts that have a colour each."""
        colours = [np.broadcast_to(rgb(colour), mesh.faces.shape) for mesh, colour in parts]
        return cls(Mesh.merge(mesh for mesh, _ in parts), np.concatenate(colours))


@dataclass(frozen=True)
class BodyPose:
    """The place of a body: its origin ``[3]`` in m and its rotation ``[3, 3]`` from its own to the valley's axes."""

    body: int
    position: np.ndarray
    rotation: np.ndarray


class SceneRenderer:
    """A valley and bodies that move in it, as pictures.

    Args:
        scenery: the valley.
        bodies: shapes of what moves; a picture is asked for with their poses.
    """

    def __init__(self, scenery: Scenery, bodies: Sequence[Body]) -> None:
        size = (float(scenery.size[0]), float(scenery.size[1]))
        ground = Mesh.merge(HeightField(scenery.heights, size).tiles())
        shown = above_ground(scenery)
        mesh = Mesh.merge([ground, Mesh(shown["vertices"], shown["triangles"])])
        kinds = np.stack([*(rgb(KINDS.get(kind, OTHER_KIND)) for kind in scenery.kind_names), rgb(OTHER_KIND)])
        colours = np.concatenate([_ground_colours(ground), kinds[shown["kinds"].astype(int), None].repeat(3, 1)])
        normals = _normals(mesh)
        corner_normals = np.concatenate([_smooth(ground), normals[len(ground.faces) :, None].repeat(3, 1)])
        self._corners = np.concatenate(_lit(colours, corner_normals), -1)
        self._static, self._bodies = _embree(mesh), list(bodies)
        self._moving = [_embree(body.mesh) for body in bodies]
        self._radii = [1.01 * float(np.linalg.norm(body.mesh.vertices, axis=1).max()) for body in bodies]
        self._shadows = _Shadows(self._static, mesh)

    def blocked(self, origin: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Return how far, in m, the valley lets one see from ``origin [3]`` along unit vectors ``[R, 3]``."""
        directions = np.asarray(towards, np.float32)
        origins = np.broadcast_to(np.asarray(origin, np.float32), directions.shape)
        return np.asarray(self._static.run(origins, directions, output=1)["tfar"])

    def picture(self, view: View, poses: Sequence[BodyPose], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return a picture ``float32 [H, W, 3]`` from 0 to 1, and how far along its ray each pixel is, in m."""
        width, height = size
        rows, columns = (axis.ravel() for axis in np.mgrid[:height, :width])
        colours, distances = self._colours(*view.rays(columns, rows, size), poses)
        picture, depth = colours.reshape(height, width, 3), distances.reshape(height, width)
        edges = np.flatnonzero(_edges(depth))
        rays = [view.rays(columns[edges] + dx, rows[edges] + dy, size) for dx, dy in SAMPLES]
        origins, directions = (np.concatenate(part) for part in zip(*rays, strict=True))
        many, _ = self._colours(origins, directions, poses)
        picture.reshape(-1, 3)[edges] = many.reshape(len(SAMPLES), -1, 3).mean(0)
        return picture, depth

    def _colours(
        self, origins: np.ndarray, directions: np.ndarray, poses: Sequence[BodyPose]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Colours ``[R, 3]`` of rays, and the distances ``[R]`` in m, few at a time for the cache."""
        starts = range(0, len(directions), CHUNK)
        parts = [self._few(origins[at : at + CHUNK], directions[at : at + CHUNK], poses) for at in starts]
        colours, distances = zip(*parts, strict=True) if parts else (np.zeros((1, 0, 3)), np.zeros((1, 0)))
        return np.concatenate(colours), np.concatenate(distances)

    def _few(
        self, origins: np.ndarray, directions: np.ndarray, poses: Sequence[BodyPose]
    ) -> tuple[np.ndarray, np.ndarray]:
        hits = self._static.run(origins, directions, output=1)
        distances, triangles = hits["tfar"], hits["primID"]
        met = triangles >= 0
        distances[~met] = np.inf
        colours = np.empty(directions.shape, np.float32)
        colours[~met] = _sky(directions[~met])
        far, u, v = distances[met], hits["u"][met, None], hits["v"][met, None]
        corners = self._corners[triangles[met]]
        shades = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        lit = self._shadows.lit(origins[met] + far[:, None] * directions[met])[:, None]
        surface = np.minimum(shades[:, :3] + lit * shades[:, 3:], 1)
        fade = np.clip((far - HAZE_FROM) / (HAZE_TO - HAZE_FROM), 0, 1)[:, None]
        colours[met] = surface + fade * (rgb(HAZE) - surface)
        for pose in poses:
            self._add(pose, origins, directions, colours, distances)
        return colours, distances

    def _add(
        self, pose: BodyPose, origins: np.ndarray, directions: np.ndarray, colours: np.ndarray, distances: np.ndarray
    ) -> None:
        """Draws a body over what is behind it; its rays are cast in its own axes."""
        offsets = pose.position.astype(np.float32) - origins
        along = np.einsum("ij,ij->i", offsets, directions)
        radius = self._radii[pose.body]
        apart = np.einsum("ij,ij->i", offsets, offsets) - along**2
        near = np.flatnonzero((apart < radius**2) & (along > -radius))
        if not len(near):
            return
        turn = pose.rotation.astype(np.float32)
        hits = self._moving[pose.body].run(-offsets[near] @ turn, directions[near] @ turn, output=1)
        nearer = (hits["primID"] >= 0) & (hits["tfar"] < distances[near])
        normals = hits["Ng"][nearer] @ turn.T
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= -np.sign(np.einsum("ij,ij->i", normals, directions[near[nearer]]))[:, None]
        shades = _lit(self._bodies[pose.body].colours[hits["primID"][nearer]], normals)
        colours[near[nearer]] = np.minimum(sum(shades), 1)
        distances[near[nearer]] = hits["tfar"][nearer]


class _Shadows:
    """A map of the distances at which the sun's rays end."""

    def __init__(self, scene: EmbreeScene, mesh: Mesh) -> None:
        lowest, highest = mesh.vertices.min(0), mesh.vertices.max(0)
        middle, radius = (lowest + highest) / 2, float(np.linalg.norm(highest - lowest)) / 2
        self._view, count = View(middle + radius * SUN, middle, width=2 * radius), min(int(2 * radius / TEXEL), TEXELS)
        self._bias = BIAS * max(2 * radius / count / TEXEL, 1.0)
        self._size = (count, count)
        self._ends = np.empty(self._size, np.float32)
        for row in range(count):  # all rays at once would take a hundred megabytes
            rays = self._view.rays(np.arange(count), np.full(count, row), self._size)
            self._ends[row] = scene.run(*rays, output=1)["tfar"]

    def lit(self, points: np.ndarray) -> np.ndarray:
        """Return how much of the sun's light reaches points ``[P, 3]``: from 0, in shadow, to 1 ``[P]``."""
        pixels, distances = self._view.pixels(points, self._size)
        (column, row), count = np.floor(pixels).astype(np.int32).T, self._size[0]
        lit = np.zeros(len(points), np.float32)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            ends = self._ends[np.clip(row + dy, 0, count - 1), np.clip(column + dx, 0, count - 1)]
            lit += distances < ends + self._bias
        return lit / 4


def _embree(mesh: Mesh) -> EmbreeScene:
    scene = EmbreeScene()
    TriangleMesh(scene, mesh.vertices, mesh.faces)
    return scene


def _normals(mesh: Mesh) -> np.ndarray:
    """Unit vectors ``[F, 3]`` upright on the triangles, where these have an area."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    across = np.cross(b - a, c - a)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


def _smooth(ground: Mesh) -> np.ndarray:
    """Normals of the ground ``[F, 3, 3]`` at each triangle's corners, the means of those of the triangles around.

    Tiles have corners of their own along their borders, so corners are told apart by their places.
    """
    corners = ground.vertices[ground.faces].reshape(-1, 3)
    _, place = np.unique(np.round(corners[:, :2], 3), axis=0, return_inverse=True)
    normals = _normals(ground).repeat(3, 0)
    sums = np.stack([np.bincount(place.ravel(), normals[:, axis]) for axis in range(3)], 1)[place.ravel()]
    return (sums / np.linalg.norm(sums, axis=1, keepdims=True)).reshape(-1, 3, 3)


def _ground_colours(ground: Mesh) -> np.ndarray:
    """Colours ``[F, 3, 3]`` of the ground's corners, by their height."""
    heights, shades = [height for height, _ in GROUND], np.stack([rgb(colour) for _, colour in GROUND])
    corners = ground.vertices[ground.faces][..., 2]
    return np.stack([np.interp(corners, heights, shades[:, channel]) for channel in range(3)], -1)


def _lit(colours: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours in the light of the sky, and what the sun adds where it shines."""
    sky, sun = 0.85 + 0.15 * normals[..., 2:], np.clip(normals @ SUN, 0, None)[..., None]
    return (AMBIENT * sky * colours).astype(np.float32), (DIFFUSE * sun * colours).astype(np.float32)


def _sky(directions: np.ndarray) -> np.ndarray:
    """The sky, paler towards the horizon."""
    height = np.clip(directions[:, 2:] / 0.5, 0, 1)
    return np.asarray(rgb(HAZE) + height * (rgb(SKY) - rgb(HAZE)))


def _edges(depth: np.ndarray) -> np.ndarray:
    """The pixels ``bool [H, W]`` on both sides of a step in the distance."""
    depth, edges = np.minimum(depth, 1e3), np.zeros(depth.shape, bool)
    for before, after in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        step = np.abs(depth[before] - depth[after]) > EDGE * np.minimum(depth[before], depth[after])
        edges[before] |= step
        edges[after] |= step
    return edges
