"""What is drawn over the pictures of a video: lines, texts, the cells that the policy reads, and a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from uavrl.errors import extras
from uavrl.evaluation.recording import RecordedFlight, Scenery
from uavrl.viewer.colours import GOAL
from uavrl.viewer.scene import SceneRenderer, View, rgb
from uavrl_onboard.geometry import spherical
from uavrl_onboard.mesh import Mesh
from uavrl_onboard.pages.shapes import BODY, shell

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

with extras():
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

CONTRAST = 2  # pixels of lines and texts for one of the picture, along each side
NEAR = ((0.0, "#fff3b0"), (0.35, "#fdc066"), (0.7, "#f0653a"), (1.0, "#9e0f2b"))  # colours of nearness, as in the page
INK, PAPER, EMPTY = "#1f2933", "#ffffff", "#dfe5ea"


class Canvas:
    """A picture, and what is drawn over it in a finer grid."""

    def __init__(self, picture: np.ndarray) -> None:
        from PIL import Image, ImageDraw

        self.picture: Image.Image = Image.fromarray((255 * picture).astype(np.uint8)).convert("RGBA")
        self.size = self.picture.size
        width, height = self.size
        self._layer = Image.new("RGBA", (CONTRAST * width, CONTRAST * height), (0, 0, 0, 0))
        self.draw: ImageDraw.ImageDraw = ImageDraw.Draw(self._layer)

    def over(self) -> Image.Image:
        """Return what is drawn over the picture, in the picture's size."""
        return self._layer.reduce(CONTRAST)

    def scale(self, pixels: float) -> float:
        """Return a length of a picture that is 800 pixels wide, in the finer grid of this one."""
        return pixels * CONTRAST * max(self.size[0] / 800, 0.7)

    def line(self, points: np.ndarray, colour: str, width: float, opacity: int = 255) -> None:
        """Draw a line through pixels ``[P, 2]``."""
        corners = [tuple(point) for point in (CONTRAST * (points + 0.5)).tolist()]
        self.draw.line(corners, fill=rgba(colour, opacity), width=max(round(self.scale(width)), 1), joint="curve")

    def text(
        self, place: tuple[float, float], text: str, ink: str, ground: str, *, right: bool = False, veil: int = 170
    ) -> None:
        """Write a text on a box whose upper left (or right) corner is at a share of the picture's width and height."""
        font, pad = _font(self.scale(14)), self.scale(6)
        width = self.draw.textlength(text, font)
        height = self.scale(14) * 1.25
        x = place[0] * CONTRAST * self.size[0] - (width + 2 * pad if right else 0)
        y = place[1] * CONTRAST * self.size[1]
        box = (x, y, x + width + 2 * pad, y + height + 1.2 * pad)
        self.draw.rounded_rectangle(box, self.scale(5), fill=rgba(ground, veil))
        self.draw.text((x + pad, y + 0.6 * pad + height / 2), text, rgba(ink), font, anchor="lm")

    def paste(self, picture: np.ndarray, corner: tuple[int, int]) -> None:
        """Put a smaller picture ``uint8 [h, w, 3]`` at a corner in pixels, with a frame around it."""
        from PIL import Image

        x, y = corner
        height, width = picture.shape[:2]
        self.picture.paste(Image.fromarray(picture).convert("RGBA"), (x, y))
        box = [CONTRAST * edge for edge in (x - 1, y - 1, x + width, y + height)]
        self.draw.rectangle(box, outline=rgba(PAPER, 220), width=CONTRAST)


class Lines:
    """Lines in the valley: opaque where they are in sight, faint behind what hides them."""

    def __init__(self, canvas: Canvas, view: View, size: tuple[int, int], depth: np.ndarray) -> None:
        self._canvas, self._view, self._size, self._depth = canvas, view, size, depth

    def add(self, points: np.ndarray, colour: str, width: float) -> None:
        """Draw a line through points ``[P, 3]`` in m."""
        pieces = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        along = np.linspace(0, pieces[-1], max(int(pieces[-1] / 0.12), 1) + 1)
        fine = np.stack([np.interp(along, pieces, points[:, axis]) for axis in range(3)], 1)
        pixels, distances = self._view.pixels(fine, self._size)
        columns, rows = np.clip(np.round(pixels), 0, np.array(self._size) - 1).astype(int).T
        seen = distances < self._depth[rows, columns] + 0.05
        near = distances > 0.3
        start = 0
        for end in range(1, len(fine)):
            whole = end == len(fine) - 1
            if whole or seen[end] != seen[start] or near[end] != near[start]:
                if near[start : end + 1].all():
                    self._canvas.line(pixels[start : end + 1], colour, width, 255 if seen[start] else 60)
                start = end


class CellsPanel:
    """The reduced scan as a panorama: straight ahead in its middle, the left side of the vehicle on the left."""

    def __init__(self, place: Scenery, width: int, height: int) -> None:
        drawn = shell(place.directions, place.ball)
        scene = EmbreeScene()
        mesh = Mesh(drawn.vertices, drawn.triangles)
        TriangleMesh(scene, mesh.vertices, mesh.faces)
        steepest = float(np.degrees(np.arcsin(np.abs(drawn.vertices[:, 2]).max() / place.ball).clip(-1, 1)))
        self._steepest = 90.0 if steepest > 60 else steepest
        azimuth = np.pi - (np.arange(width) + 0.501) * 2 * np.pi / width  # no ray along a border of cells
        elevation = np.radians(self._steepest) * (1 - (np.arange(height) + 0.5) * 2 / height)
        elevation, azimuth = (angle.ravel() for angle in np.meshgrid(elevation, azimuth, indexing="ij"))
        rays = spherical(azimuth, elevation).astype(np.float32)
        met = scene.run(np.zeros_like(rays), rays, output=1)["primID"]
        self._of = np.where(met < 0, -1, drawn.faces[met]).reshape(height, width)
        across, down = np.diff(self._of, axis=1) != 0, np.diff(self._of, axis=0) != 0
        self._borders = np.zeros(self._of.shape, bool)
        self._borders[:, 1:] |= across
        self._borders[1:] |= down
        self._ball, self._ranges = place.ball, place.statistic == "range"
        self._caption = f"LiDAR, {len(place.directions)} cells, 0 to {place.ball:g} m"

    def add(self, canvas: Canvas, reported: np.ndarray) -> None:
        """Draw what the cells report ``[cells]``, 0 where they report nothing."""
        near = np.clip(reported / self._ball, 0, 1)
        shades = nearness(1 - near if self._ranges else near)
        shades[reported <= 0] = rgb(EMPTY)
        picture = np.append(shades, rgb(PAPER)[None], 0)[self._of]
        picture[self._borders] *= 0.82
        height, width = self._of.shape
        x, y = round(0.015 * canvas.size[0]), canvas.size[1] - height - round(0.015 * canvas.size[0])
        canvas.paste((255 * picture).astype(np.uint8), (x, y))
        middle = np.array([[x + width / 2, y - 3], [x + width / 2, y + 3]])
        canvas.line(middle, INK, 2)
        text = canvas.scale(11) * 1.25 + 1.2 * canvas.scale(6)
        canvas.text(
            (x / canvas.size[0], (y - 6) / canvas.size[1] - text * 1.25 / CONTRAST / canvas.size[1]),
            self._caption,
            PAPER,
            INK,
        )


class MapPanel:
    """The valley from above, with the path so far."""

    def __init__(self, scene: SceneRenderer, place: Scenery, width: int) -> None:
        long, wide = (float(length) for length in place.size)
        self.size = (width, round(width * wide / long))
        eye, middle = np.array([0.0, 0.0, 20.0]), np.zeros(3)
        self._view = View(eye, middle, width=long, up=(0.0, 1.0, 0.0))
        picture, _ = scene.picture(self._view, [], self.size)
        self._picture = (255 * picture).astype(np.uint8)
        self._radius = float(place.goal[0])

    def add(self, canvas: Canvas, flown: np.ndarray, rotation: np.ndarray, flight: RecordedFlight, colour: str) -> None:
        """Draw the map with the path ``[P, 3]``, the goal and the vehicle."""
        margin = round(0.015 * canvas.size[0])
        corner = np.array(canvas.size) - self.size - margin
        canvas.paste(self._picture, (int(corner[0]), int(corner[1])))

        def pixels(points: np.ndarray) -> np.ndarray:
            return corner + self._view.pixels(points, self.size)[0]

        canvas.line(pixels(flight.goal + ring(self._radius)), GOAL, 3)
        canvas.line(pixels(flown), colour, 2)
        arrow = np.array([[1.3, 0.0, 0.0], [-0.7, 0.8, 0.0], [-0.7, -0.8, 0.0], [1.3, 0.0, 0.0]])
        places = CONTRAST * (pixels(flown[-1] + arrow @ rotation.T) + 0.5)
        canvas.draw.polygon([tuple(place) for place in places.tolist()], fill=rgba(BODY), outline=rgba(PAPER))


def nearness(shares: np.ndarray) -> np.ndarray:
    """Colours ``[N, 3]`` of shares from 0, far, to 1, near."""
    stops, shades = [stop for stop, _ in NEAR], np.stack([rgb(colour) for _, colour in NEAR])
    return np.stack([np.interp(shares, stops, shades[:, channel]) for channel in range(3)], -1)


def rgba(colour: str, opacity: int = 255) -> tuple[int, ...]:
    """The channels of a colour written as ``#rrggbb``, 0 to 255."""
    return (*(int(colour[place : place + 2], 16) for place in (1, 3, 5)), opacity)


def _font(size: float) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def ring(radius: float, sides: int = 48) -> np.ndarray:
    """A level circle ``[sides + 1, 3]``."""
    angles = np.linspace(0, 2 * np.pi, sides + 1)
    return radius * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], 1)
