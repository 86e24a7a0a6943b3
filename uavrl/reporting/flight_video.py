"""A film of one flight, drawn by PyBullet's software renderer from behind the vehicle."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation, Slerp
from tqdm import tqdm

from uavrl.envs.bullet import pybullet, silenced
from uavrl.envs.mesh import Mesh
from uavrl.envs.terrain import HeightField
from uavrl.errors import UavrlError
from uavrl.flying.recording import RecordedFlight, Scenery
from uavrl.reporting.flight_shapes import GOAL, KINDS, OTHER_KIND, OUTCOMES, PLANE, cage, vehicle

FRAME_RATE = 20  # per second; the flight is kept at 10
GROUND = {-10.0: "#bfb591", -0.15: "#c6bc9a", 0.15: "#cdc4a5", 0.6: "#d0c7ab", 2.0: "#d2cab0", 4.0: "#d6d0bc"}  # from m
SKY = np.array([[150, 190, 222], [235, 242, 246]])  # above and at the horizon


def needs_imageio() -> Any:
    """Returns imageio's writer."""
    try:
        import imageio_ffmpeg  # noqa: F401
        from imageio import v2
    except ImportError as error:
        raise UavrlError(
            "A film needs imageio and imageio-ffmpeg, which are not installed: pip install 'uavrl[video]', or leave "
            "video out."
        ) from error
    return v2


class Camera:
    """Draws one flight in a PyBullet world of its own, in which nothing moves by itself."""

    def __init__(self, flight: RecordedFlight, scenery: Scenery, size: tuple[int, int] = (640, 360)) -> None:
        self.flight, self.size = flight, size
        with silenced():
            self._client = pybullet.connect(pybullet.DIRECT)
        self._add_valley(scenery)
        plane = Mesh(scenery.plane_vertices, scenery.plane_triangles)
        self._planes = [self._add(plane, PLANE) for _ in range(flight.planes.shape[1])]
        self._vehicle = [self._add(part.mesh, part.colour) for part in vehicle()]
        self._add(cage(*scenery.goal.tolist()).translated(flight.goal), GOAL)
        attitudes = Rotation.from_quat(flight.attitudes)
        self._turn = Slerp(flight.times, attitudes)
        self._position = interp1d(flight.times, flight.positions, axis=0)
        self._look = interp1d(flight.times, _smoothed(attitudes.apply([1.0, 0.0, 0.0])[:, :2]), axis=0)

    def _add_valley(self, scenery: Scenery) -> None:
        for ground in HeightField(scenery.heights, (float(scenery.size[0]), float(scenery.size[1]))).tiles():
            level = ground.vertices[ground.faces][..., 2].mean(1)
            band = np.digitize(level, list(GROUND)[1:])
            for i, colour in enumerate(GROUND.values()):
                self._add_solid(Mesh(ground.vertices, ground.faces[band == i]), colour)
        for i, kind in enumerate(scenery.kind_names):
            mesh = Mesh(scenery.vertices, scenery.triangles[scenery.kinds == i])
            self._add_solid(mesh, KINDS.get(kind, OTHER_KIND))

    def _add_solid(self, mesh: Mesh, colour: str) -> None:
        """What the camera asks whether it is in its way."""
        for part in mesh.split():
            hull = pybullet.createCollisionShape(
                pybullet.GEOM_MESH,
                vertices=part.vertices.tolist(),
                indices=part.faces.ravel().tolist(),
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
            self._add(part, colour, hull)

    def _add(self, mesh: Mesh, colour: str, hull: int = -1) -> int:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=mesh.vertices.tolist(),
            indices=mesh.faces.ravel().tolist(),
            normals=_normals(mesh).tolist(),
            rgbaColor=[*(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0],
            specularColor=[0.05, 0.05, 0.05],
            physicsClientId=self._client,
        )
        return pybullet.createMultiBody(0, hull, shape, physicsClientId=self._client)

    def render(self, time: float) -> np.ndarray:
        """Returns the picture ``uint8 [height, width, 3]`` at a time in s."""
        time = float(np.clip(time, self.flight.times[0], self.flight.times[-1]))
        position, attitude = self._position(time), self._turn(time).as_quat()
        for body in self._vehicle:
            self._move(body, position, attitude)
        for body, (x, y, z, yaw) in zip(self._planes, self.flight.planes[moment(self.flight, time)], strict=True):
            self._move(body, np.array([x, y, z]), Rotation.from_euler("z", yaw).as_quat())
        look = self._look(time)
        eye = position + np.append(-2.6 * look, 1.1)
        hit = pybullet.rayTest(position.tolist(), eye.tolist(), physicsClientId=self._client)[0]
        if hit[0] >= 0:
            eye = position + max(0.8 * hit[2], 0.15) * (eye - position)
        return self._picture(eye, position + np.append(1.5 * look, 0.1))

    def _move(self, body: int, position: np.ndarray, attitude: np.ndarray) -> None:
        pybullet.resetBasePositionAndOrientation(
            body, position.tolist(), attitude.tolist(), physicsClientId=self._client
        )

    def _picture(self, eye: np.ndarray, aim: np.ndarray) -> np.ndarray:
        width, height = self.size
        _, _, rgba, _, bodies = pybullet.getCameraImage(
            width,
            height,
            pybullet.computeViewMatrix(eye.tolist(), aim.tolist(), [0, 0, 1]),
            pybullet.computeProjectionMatrixFOV(65, width / height, 0.05, 80),
            lightDirection=[20, -12, 40],
            lightAmbientCoeff=0.7,
            lightDiffuseCoeff=0.45,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)[..., :3]
        rows = np.linspace(0, 1, height)[:, None, None] ** 0.7
        sky = (SKY[0] * (1 - rows) + SKY[1] * rows).astype(np.uint8)
        return np.where(np.asarray(bodies).reshape(height, width, 1) < 0, sky, image)

    def close(self) -> None:
        """Frees the PyBullet world; a second call does nothing."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1


def _smoothed(ahead: np.ndarray) -> np.ndarray:
    """Headings ``[T, 2]`` of length 1 that do not swing."""
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    for i in range(1, len(ahead)):
        ahead[i] = 0.8 * ahead[i - 1] + 0.2 * ahead[i]
    return ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)


def _normals(mesh: Mesh) -> np.ndarray:
    """A unit normal at each vertex, the mean over the triangles around it."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    normals = np.zeros((len(mesh.vertices), 3))
    np.add.at(normals, mesh.faces, np.cross(b - a, c - a)[:, None])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def moment(flight: RecordedFlight, time: float) -> int:
    """The newest moment that a time has reached."""
    return max(int(np.searchsorted(flight.times, time + 1e-9, side="right")) - 1, 0)


def _titled(image: np.ndarray, flight: RecordedFlight, time: float) -> np.ndarray:
    """Writes time, speed and distance into a picture, and at the end the outcome."""
    from PIL import Image, ImageDraw, ImageFont  # imageio brings it

    picture = Image.fromarray(image)
    draw, font = ImageDraw.Draw(picture, "RGBA"), ImageFont.load_default(15)
    now = moment(flight, time)
    speed, distance = float(np.linalg.norm(flight.velocities[now])), float(flight.distances[now])
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


def frames(flight: RecordedFlight, scenery: Scenery) -> Iterator[np.ndarray]:
    """Yields the pictures of a flight, ``uint8 [height, width, 3]``, and a second of the last one."""
    camera = Camera(flight, scenery)
    try:
        for time in np.arange(0, flight.times[-1], 1 / FRAME_RATE):
            yield _titled(camera.render(time), flight, float(time))
        last = _titled(camera.render(flight.times[-1]), flight, float(flight.times[-1]))
    finally:
        camera.close()
    yield from [last] * FRAME_RATE


def write_video(flight: RecordedFlight, scenery: Scenery, output: Path, *, progress: bool = False) -> None:
    """Writes a flight as a film, 640 × 360 at 20 frames a second."""
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
