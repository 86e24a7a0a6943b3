"""A video of one episode, seen from behind the vehicle: MP4 or GIF, drawn without a browser or a graphics card."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation, Slerp

from uavrl.errors import UavrlError, extras
from uavrl.evaluation.recording import RecordedFlight, Recording
from uavrl.runs.episodes import SAID
from uavrl.runs.progress_line import ProgressLine
from uavrl.viewer.colours import GOAL, OUTCOMES, PLANE
from uavrl.viewer.overlay import INK, NEAR, PAPER, Canvas, CellsPanel, Lines, MapPanel, nearness, rgba, ring
from uavrl.viewer.scene import Body, BodyPose, SceneRenderer, View, rgb
from uavrl_onboard.files import replacing
from uavrl_onboard.geometry import heading_vector, yaw_rotation
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.pages.shapes import BODY, HEAD, vehicle


@dataclass(frozen=True)
class Format:
    """The size of the pictures in pixels, which are even for MP4, and how many there are in a second."""

    size: tuple[int, int]
    rate: int


FORMATS = {".mp4": Format((736, 416), 15), ".gif": Format((448, 256), 6)}
BEHIND, ABOVE, AHEAD = 4.4, 1.7, 2.0  # m from the vehicle: the camera's place, and the point that it looks at
NEAREST = 0.3  # the share of its distance that the camera keeps in front of an obstacle
STEADY, EASED = 0.6, 0.4  # s, over which the camera's heading and its distance are smoothed
LAST = 1.0  # s for which the last picture stays
COLOURS = 64  # of a GIF
# Those of small things, which would be lost among the colours that most of a picture has.
SMALL = (BODY, "#005a8e", HEAD, "#a66298", PLANE, GOAL, *OUTCOMES.values(), *(colour for _, colour in NEAR), "#22262b")
VEHICLE_BODY, PLANE_BODY = 0, 1


def require_libraries(path: Path) -> None:
    """Refuse a video whose library is missing, in one sentence."""
    with extras():
        import PIL  # noqa: F401

        if path.suffix == ".mp4":
            import av  # noqa: F401


def require_one_episode(recording: Recording) -> None:
    """Refuse a recording of several episodes."""
    count = len(recording.flights)
    if count != 1:
        raise UavrlError(f"A video shows one episode, and the recording has {count}: record one with task=NUMBER.")


def write_video(recording: Recording, path: Path, *, progress: bool = True) -> None:
    """Write a video of the only episode of a recording.

    Args:
        recording: one episode.
        path: the file, which ends in ``.mp4`` or ``.gif``.
        progress: whether a progress line is shown.

    Raises:
        UavrlError: if the recording has several episodes, the file another suffix, or a library is missing.
    """
    if path.suffix not in FORMATS:
        raise UavrlError(f"A video is a file that ends in {' or '.join(FORMATS)}, got {path}.")
    require_libraries(path)
    require_one_episode(recording)
    film = Film(recording, FORMATS[path.suffix])
    with replacing(path) as partial, ProgressLine(len(film), "pictures", enabled=progress) as line:
        pictures = _counted(film, line)
        if path.suffix == ".mp4":
            _write_mp4(pictures, partial, film.format)
        else:
            _write_gif(list(pictures), partial, film.format)


def _counted(film: Film, line: ProgressLine) -> Iterator[np.ndarray]:
    for picture in film:
        yield picture
        line.add()


def _write_mp4(pictures: Iterator[np.ndarray], path: Path, form: Format) -> None:
    import av

    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=form.rate, options={"crf": "21", "preset": "medium"})
        stream.width, stream.height = form.size
        stream.pix_fmt = "yuv420p"  # which browsers and phones play
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, form.rate)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def _write_gif(pictures: list[np.ndarray], path: Path, form: Format) -> None:
    """All pictures share one palette, so that what stands still keeps its colours and takes no room."""
    from PIL import Image

    some = np.concatenate(pictures[:: max(len(pictures) // 8, 1)])
    common = Image.fromarray(some).quantize(COLOURS - len(SMALL), Image.Quantize.MEDIANCUT).getpalette()
    assert common is not None
    palette = Image.new("P", (1, 1))
    palette.putpalette([*common, *(channel for colour in SMALL for channel in rgba(colour)[:3])])
    first, *rest = (Image.fromarray(each).quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures)
    durations = 10 * np.diff(np.round(np.arange(len(pictures) + 1) * 100 / form.rate))  # whole hundredths of a second
    options: dict[str, Any] = {"duration": durations.astype(int).tolist(), "loop": 0, "optimize": True}
    first.save(path, "GIF", save_all=True, append_images=rest, **options)


class Film:
    """The pictures ``uint8 [H, W, 3]`` of the first episode of a recording, one after the other."""

    def __init__(self, recording: Recording, form: Format) -> None:
        self.format, self._flight = form, recording.flights[0]
        self._place = recording.scenery(self._flight)
        plane = Mesh(self._place.plane_vertices, self._place.plane_triangles)
        self._scene = SceneRenderer(self._place, [Body.of(vehicle()), Body.of([(plane, PLANE)])])
        self._title = title(recording, self._flight)
        end = float(self._flight.times[-1])
        self._times = np.append(np.arange(0.0, end, 1 / form.rate), end)
        self._still = round(LAST * form.rate) - 1  # further pictures of the end
        self._path = _Path(self._flight)
        self._cells = CellsPanel(self._place, self._pixels(0.27), self._pixels(0.065))
        self._map = MapPanel(self._scene, self._place, self._pixels(0.2))

    def __len__(self) -> int:
        return len(self._times) + self._still

    def __iter__(self) -> Iterator[np.ndarray]:
        for time, view in zip(self._times, self._views(), strict=True):
            picture = self._picture(time, view)
            yield picture
        for _ in range(self._still):
            yield picture

    def _pixels(self, share: float) -> int:
        return round(share * self.format.size[0])

    def _views(self) -> list[View]:
        """The camera at each time: behind the vehicle, and nearer where something would hide it."""
        times, rate = self._times, self.format.rate
        places, rotations = self._path.at(times)
        headings = gaussian_filter1d(heading_vector(_yaws(rotations)), STEADY * rate, axis=0, mode="nearest")
        headings /= np.linalg.norm(headings, axis=1, keepdims=True)
        ahead = np.column_stack([headings, np.zeros(len(times))])
        offsets = -BEHIND * ahead + [0.0, 0.0, ABOVE]
        length = float(np.hypot(BEHIND, ABOVE))
        free = [
            self._scene.blocked(place, _cone(offset / length)).min()
            for place, offset in zip(places, offsets, strict=True)
        ]
        share = np.clip(0.9 * np.array(free) / length, NEAREST, 1.0)
        share = gaussian_filter1d(
            minimum_filter1d(share, max(int(rate), 1), mode="nearest"), EASED * rate, mode="nearest"
        )
        eyes, targets = places + share[:, None] * offsets, places + AHEAD * ahead
        return [View(eye, target) for eye, target in zip(eyes, targets, strict=True)]

    def _picture(self, time: float, view: View) -> np.ndarray:
        from PIL import Image

        flight, size = self._flight, self.format.size
        (place,), (rotation,) = self._path.at(np.array([time]))
        step = self._path.step(time)
        poses = [BodyPose(VEHICLE_BODY, place, rotation), *self._planes(time, step)]
        picture, depth = self._scene.picture(view, poses, size)
        self._add_goal(picture, depth, view)
        self._add_points(picture, depth, view, step)
        canvas = Canvas(picture)
        colour = OUTCOMES[flight.summary.outcome]
        flown = np.concatenate([flight.positions[: step + 1], place[None]])
        lines = Lines(canvas, view, size, depth)
        lines.add(flown, colour, 3.0)
        radius, height = self._place.goal
        for level in (-0.5, 0.0, 0.5):
            lines.add(flight.goal + ring(radius) + [0, 0, level * height], "#b8860b", 1.5)
        below = self._scene.blocked(place, np.array([[0.0, 0.0, -1.0]]))[0]
        lines.add(np.stack([place - [0, 0, 0.1], place - [0, 0, min(below, 20.0)]]), BODY, 1.0)
        lines.add(place - [0, 0, min(below, 20.0) - 0.03] + ring(0.3), BODY, 1.0)
        self._write(canvas, time, step)
        self._cells.add(canvas, flight.faces[step])
        self._map.add(canvas, flown, rotation, flight, colour)
        return np.asarray(Image.alpha_composite(canvas.picture, canvas.over()).convert("RGB"))

    def _planes(self, time: float, step: int) -> list[BodyPose]:
        planes, following = self._flight.planes, min(step + 1, len(self._flight.times) - 1)
        part = self._path.part(time)
        poses = []
        for before, after in zip(planes[step], planes[following], strict=True):
            stays = np.abs(after[:3] - before[:3]).max() < 2.0  # others have left and come back elsewhere
            place = before[:3] + (part * (after[:3] - before[:3]) if stays else 0.0)
            poses.append(BodyPose(PLANE_BODY, place, yaw_rotation(before[3])))
        return poses

    def _add_goal(self, picture: np.ndarray, depth: np.ndarray, view: View) -> None:
        """Tints what is seen through the goal's cylinder, once for each of its walls in sight."""
        radius, height = self._place.goal
        goal, size = self._flight.goal, self.format.size
        rims = np.concatenate([goal + ring(radius) + [0, 0, end * height / 2] for end in (-1, 1)])
        pixels, distances = view.pixels(rims, size)
        if distances.max() <= 0:
            return
        low, high = np.floor(pixels[distances > 0].min(0)) - 1, np.ceil(pixels[distances > 0].max(0)) + 2
        if distances.min() <= 0:  # the camera is above or below it
            low, high = np.zeros(2), np.array(size)
        low, high = np.clip(low, 0, size).astype(int), np.clip(high, 0, size).astype(int)
        rows, columns = (axis.ravel() for axis in np.mgrid[low[1] : high[1], low[0] : high[0]])
        if not len(rows):
            return
        origins, directions = view.rays(columns, rows, size)
        offset, flat = origins[:, :2] - goal[:2], directions[:, :2]
        a, b = (flat**2).sum(1), (flat * offset).sum(1)
        inside = b**2 - a * ((offset**2).sum(1) - radius**2)
        root = np.sqrt(np.maximum(inside, 0))
        tint = np.zeros(len(rows), np.float32)
        for sign in (-1, 1):
            far = (-b + sign * root) / np.maximum(a, 1e-9)
            level = np.abs(origins[:, 2] + far * directions[:, 2] - goal[2]) < height / 2
            tint += (inside > 0) & (far > 0) & (far < depth[rows, columns]) & level
        picture[rows, columns] += 0.22 * tint[:, None] * (rgb(GOAL) - picture[rows, columns])

    def _add_points(self, picture: np.ndarray, depth: np.ndarray, view: View, step: int) -> None:
        """Draws the points of the scan in the colours of their distance, where they are in sight."""
        flight, size = self._flight, self.format.size
        cloud = flight.cloud(step)
        ranges = np.linalg.norm(cloud, axis=1)
        turn = Rotation.from_quat(flight.attitudes[step]).as_matrix()
        points = flight.positions[step] + (cloud + self._place.sensor) @ turn.T
        pixels, distances = view.pixels(points, size)
        columns, rows = np.round(pixels).astype(int).T
        shown = (ranges < self._place.ball) & (distances > 0)
        shown &= (columns >= 0) & (columns < size[0] - 1) & (rows >= 0) & (rows < size[1] - 1)
        columns, rows, distances = columns[shown], rows[shown], distances[shown]
        shades = nearness(1 - ranges[shown] / self._place.ball)
        seen = distances < depth[rows, columns] + 0.15
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            picture[rows[seen] + dy, columns[seen] + dx] = shades[seen]

    def _write(self, canvas: Canvas, time: float, step: int) -> None:
        flight = self._flight
        canvas.text((0.012, 0.02), self._title, PAPER, INK)
        distance = max(float(np.hypot(*(flight.positions[step] - flight.goal)[:2])) - float(self._place.goal[0]), 0.0)
        speed = float(np.linalg.norm(flight.velocities[step]))
        numbers = f"{time:4.1f} s    {speed:.1f} m/s    goal {distance:4.1f} m"
        canvas.text((0.988, 0.02), numbers, PAPER, INK, right=True)
        if time >= flight.times[-1]:
            outcome = flight.summary.outcome
            canvas.text((0.988, 0.095), SAID[outcome], "#10141a", OUTCOMES[outcome], right=True, veil=255)


def title(recording: Recording, flight: RecordedFlight) -> str:
    """Return the policy, its training steps, the valley and the task of an episode, in one line."""
    source, summary = recording.source, flight.summary
    name = str(source.get("run") or source.get("policy") or "a policy")
    steps = source.get("training_steps")
    trained = f", {steps:,} training steps" if isinstance(steps, int) and steps else ""
    valley = "" if summary.world_seed is None else f", valley {summary.world_seed}"
    return f"{name}{trained}{valley}, task {summary.task}"


class _Path:
    """Where the vehicle is between the recorded moments."""

    def __init__(self, flight: RecordedFlight) -> None:
        self._times, self._positions = flight.times, flight.positions
        self._turns = Slerp(flight.times, Rotation.from_quat(flight.attitudes))

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places ``[N, 3]`` and rotations ``[N, 3, 3]``."""
        places = [np.interp(times, self._times, self._positions[:, axis]) for axis in range(3)]
        return np.stack(places, 1), self._turns(times).as_matrix()

    def step(self, time: float) -> int:
        """Return the last recorded moment at a time or before it."""
        return int(np.searchsorted(self._times, time + 1e-9, side="right")) - 1

    def part(self, time: float) -> float:
        """Return which share of the way to the next moment has passed."""
        step = self.step(time)
        if step + 1 >= len(self._times):
            return 0.0
        return float((time - self._times[step]) / (self._times[step + 1] - self._times[step]))


def _yaws(rotations: np.ndarray) -> np.ndarray:
    return np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])


def _cone(direction: np.ndarray, spread: float = 0.08) -> np.ndarray:
    """Unit vectors around a direction, and itself."""
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, direction)
    rays = direction + spread * np.stack([0 * side, side, -side, up, -up])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
