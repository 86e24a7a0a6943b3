"""A film of one flight, drawn by PyBullet's software renderer from behind the vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from tqdm import tqdm

from uavrl.envs.bodies import split_mesh
from uavrl.envs.bullet import pybullet, silenced
from uavrl.envs.mesh import Mesh
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.reporting.flight_shapes import GOAL, KINDS, OTHER_KIND, OUTCOMES, PLANE, cage, vehicle
from uavrl.training.flight import RecordedFlight, Scenery

FRAME_RATE = 20  # per second; the flight is kept at 10
GROUND_BANDS = (-10.0, -0.15, 0.15, 0.6, 2.0, 4.0, 6.0, 20.0)  # m: each has a colour of its own
_GROUND = ("#bfb591", "#c6bc9a", "#cdc4a5", "#d0c7ab", "#d2cab0", "#d4cdb6", "#d6d0bc")
_SKY = np.array([[150, 190, 222], [235, 242, 246]])  # above and at the horizon


def needs_imageio() -> Any:
    """Returns imageio's writer.

    Raises:
        UavrlError: when imageio or its ffmpeg is not installed.
    """
    try:
        import imageio_ffmpeg  # noqa: F401
        from imageio import v2
    except ImportError as error:
        raise UavrlError(
            "A film needs imageio and imageio-ffmpeg, which are not installed: pip install 'uavrl[video]', or leave "
            "video out."
        ) from error
    return v2


class Stage:
    """A PyBullet world with the visible shapes of one flight; nothing in it moves by itself.

    Args:
        flight: What is shown.
        scenery: Its valley.
        size: Width and height of a frame.
    """

    def __init__(self, flight: RecordedFlight, scenery: Scenery, size: tuple[int, int] = (640, 360)) -> None:
        self.flight, self.size = flight, size
        with silenced():
            self._client = pybullet.connect(pybullet.DIRECT)
        self._add_valley(scenery)
        plane = Mesh(scenery.plane_vertices, scenery.plane_triangles)
        self._planes = [self._add(plane, PLANE) for _ in range(flight.planes.shape[1])]
        self._vehicle = [self._add(part.mesh, part.colour) for part in vehicle()]
        self._add(cage(*scenery.goal.tolist()).translated(flight.goal), GOAL)
        self._turn = Slerp(flight.times, Rotation.from_quat(flight.attitudes))
        self._looks = self._smooth_headings()

    def _add_valley(self, scenery: Scenery) -> None:
        ground = Mesh.merge(HeightField(scenery.heights, (float(scenery.size[0]), float(scenery.size[1]))).tiles())
        level = ground.vertices[ground.faces][..., 2].mean(1)
        band = np.digitize(level, GROUND_BANDS[1:-1])
        for i, colour in enumerate(_GROUND):
            self._add_fixed(Mesh(ground.vertices, ground.faces[band == i]), colour)
        for i, kind in enumerate(scenery.kind_names):
            some = scenery.triangles[scenery.kinds == i]
            self._add_fixed(Mesh(scenery.vertices, some), KINDS.get(kind, OTHER_KIND))

    def _add_fixed(self, mesh: Mesh, colour: str) -> None:
        used, faces = np.unique(mesh.faces, return_inverse=True)
        for part in split_mesh(Mesh(mesh.vertices[used], faces.reshape(-1, 3))) if len(used) else ():
            self._add(part, colour, solid=True)

    def _add(self, mesh: Mesh, colour: str, solid: bool = False) -> int:
        vertices, normals = _smooth(mesh)
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=vertices.tolist(),
            indices=mesh.faces.ravel().tolist(),
            normals=normals.tolist(),
            rgbaColor=[*_rgb(colour), 1.0],
            specularColor=[0.05, 0.05, 0.05],
            physicsClientId=self._client,
        )
        hull = -1
        if solid:  # so that the camera can ask whether something is in its way
            hull = pybullet.createCollisionShape(
                pybullet.GEOM_MESH,
                vertices=vertices.tolist(),
                indices=mesh.faces.ravel().tolist(),
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
        return pybullet.createMultiBody(0, hull, shape, physicsClientId=self._client)

    def _smooth_headings(self) -> np.ndarray:
        """Headings ``[T + 1, 2]``, smoothed so that the camera does not swing."""
        ahead = Rotation.from_quat(self.flight.attitudes).apply([1.0, 0.0, 0.0])[:, :2]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        for i in range(1, len(ahead)):
            ahead[i] = 0.8 * ahead[i - 1] + 0.2 * ahead[i]
        return ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)

    def frame(self, time: float) -> np.ndarray:
        """Returns the picture ``uint8 [height, width, 3]`` at a time in s."""
        times = self.flight.times
        time = float(np.clip(time, times[0], times[-1]))
        position = np.array([np.interp(time, times, axis) for axis in self.flight.positions.T])
        for body in self._vehicle:
            pybullet.resetBasePositionAndOrientation(
                body, position.tolist(), self._turn(time).as_quat().tolist(), physicsClientId=self._client
            )
        for i, body in enumerate(self._planes):
            x, y, z, yaw = self._plane(i, time)
            turn = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
            pybullet.resetBasePositionAndOrientation(body, (x, y, z), turn, physicsClientId=self._client)
        look = np.array([np.interp(time, times, axis) for axis in self._looks.T])
        return self._picture(position, look)

    def _plane(self, index: int, time: float) -> list[float]:
        poses = self.flight.planes[:, index]
        after = min(int(np.searchsorted(self.flight.times, time)), len(poses) - 1)
        before = max(after - 1, 0)
        if np.linalg.norm(poses[after, :2] - poses[before, :2]) > 2.0:  # it has entered anew
            return poses[after].tolist()
        share = np.interp(time, self.flight.times[[before, after]], [0.0, 1.0]) if after > before else 0.0
        return [*(poses[before, :3] + share * (poses[after, :3] - poses[before, :3])).tolist(), float(poses[after, 3])]

    def _picture(self, position: np.ndarray, look: np.ndarray) -> np.ndarray:
        width, height = self.size
        aim = position + np.append(1.5 * look, 0.1)
        eye = position + np.append(-2.6 * look, 1.1)
        hit = pybullet.rayTest(position.tolist(), eye.tolist(), physicsClientId=self._client)[0]
        if hit[0] >= 0:
            eye = position + max(0.8 * hit[2], 0.15) * (eye - position)
        view = pybullet.computeViewMatrix(eye.tolist(), aim.tolist(), [0, 0, 1])
        projection = pybullet.computeProjectionMatrixFOV(65, width / height, 0.05, 80)
        _, _, rgba, _, bodies = pybullet.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=[20, -12, 40],
            lightAmbientCoeff=0.7,
            lightDiffuseCoeff=0.45,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)[..., :3].copy()
        rows = np.linspace(0, 1, height)[:, None] ** 0.7
        sky = (_SKY[0] * (1 - rows) + _SKY[1] * rows).astype(np.uint8)
        empty = np.asarray(bodies).reshape(height, width) < 0
        image[empty] = np.broadcast_to(sky[:, None], image.shape)[empty]
        return image

    def close(self) -> None:
        """Frees the PyBullet world; a second call does nothing."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1


def _rgb(colour: str) -> list[float]:
    return [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]


def _smooth(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices and a unit normal at each, the mean over the triangles around it."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(mesh.vertices), 3))
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], across)
    return mesh.vertices, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _moment(times: np.ndarray, time: float) -> int:
    """The newest moment that a time has reached.

    Examples:
        >>> [_moment(np.array([0.0, 0.1, 0.2]), time) for time in (0.0, 0.05, 0.1, 9.0)]
        [0, 0, 1, 2]
    """
    return max(int(np.searchsorted(times, time + 1e-9, side="right")) - 1, 0)


def _titled(image: np.ndarray, flight: RecordedFlight, time: float) -> np.ndarray:
    """Writes time, speed and distance into a picture, and at the end the outcome."""
    from PIL import Image, ImageDraw, ImageFont  # imageio brings it

    picture = Image.fromarray(image)
    draw, font = ImageDraw.Draw(picture, "RGBA"), ImageFont.load_default(15)
    moment = _moment(flight.times, time)
    speed, distance = float(np.linalg.norm(flight.velocities[moment])), float(flight.distances[moment])
    text = f"task {flight.summary.task}   {time:4.1f} s   {speed:.1f} m/s   {distance:.1f} m to the goal"
    draw.rounded_rectangle((8, 8, 20 + draw.textlength(text, font), 34), 6, fill=(20, 26, 32, 150))
    draw.text((14, 12), text, font=font, fill="white")
    if time >= flight.times[-1]:
        word = flight.summary.outcome.replace("_", " ")
        wide = draw.textlength(word, font)
        right = picture.width - 8
        draw.rounded_rectangle((right - wide - 24, 8, right, 34), 13, fill=OUTCOMES[flight.summary.outcome])
        draw.text((right - wide - 12, 12), word, font=font, fill="white")
    return np.asarray(picture)


def frames(flight: RecordedFlight, scenery: Scenery, size: tuple[int, int] = (640, 360)) -> Iterator[np.ndarray]:
    """Yields the pictures of a flight, ``uint8 [height, width, 3]``, and a second of the last one."""
    stage = Stage(flight, scenery, size)
    try:
        for time in np.arange(0, flight.times[-1], 1 / FRAME_RATE):
            yield _titled(stage.frame(time), flight, float(time))
        last = _titled(stage.frame(flight.times[-1]), flight, float(flight.times[-1]))
    finally:
        stage.close()
    for _ in range(FRAME_RATE):
        yield last


def write_video(flight: RecordedFlight, scenery: Scenery, output: Path, *, progress: bool = False) -> None:
    """Writes a flight as a film, 640 × 360 at 20 frames a second.

    Args:
        flight: The flight.
        scenery: Its valley.
        output: The file, ``.mp4``.
        progress: Show a progress line.

    Raises:
        UavrlError: when imageio is not installed, or ffmpeg cannot write such a file.
    """
    imageio = needs_imageio()
    total = int(np.ceil(flight.times[-1] * FRAME_RATE)) + FRAME_RATE
    partial = output.with_name(output.stem + ".partial" + output.suffix)
    partial.unlink(missing_ok=True)  # it may be a link to somewhere else
    try:
        with imageio.get_writer(partial, fps=FRAME_RATE, macro_block_size=8, quality=7) as writer:
            for image in tqdm(frames(flight, scenery), total=total, disable=not progress, unit="frame"):
                writer.append_data(image)
    except (ValueError, OSError) as error:
        partial.unlink(missing_ok=True)
        reason = str(error).splitlines()[0]
        raise UavrlError(f"{output} cannot be made ({reason}): name a film that ends in .mp4.") from error
    partial.replace(output)
