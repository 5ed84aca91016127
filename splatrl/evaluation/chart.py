"""The map panel of a video: its background is drawn once, and the robot is drawn on it for every frame."""

import math
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from splatrl.bodies import Body, Box, Sphere
from splatrl.envs.tasks import Mark, Outcome
from splatrl.evaluation.figure_style import BLUE, INK, MISSED, PARTLY, REACHED, font, mark_styles
from splatrl.evaluation.recording import Recording
from splatrl.evaluation.start_maps import ARROW
from splatrl.evaluation.topdown import MapView

FINE = 2
"""Supersampling factor: the map is drawn this much larger and then reduced, which smooths its lines."""
APART = 7
"""Minimum distance between the dots of a trail, pixels."""
COLORS = {
    Outcome.RUNNING: BLUE,
    Outcome.GOAL: REACHED,
    Outcome.TIMEOUT: PARTLY,
    Outcome.COLLISION: MISSED,
    Outcome.OUT_OF_BOUNDS: MISSED,
    Outcome.STOPPED: MISSED,
}


class Chart:
    """The map of one scene and task.

    Args:
        view: background and marks of the map.
        body: the robot's body.
        box: maximum width and height, pixels.

    Attributes:
        size: width and height, pixels.
    """

    def __init__(self, view: MapView, body: Body, box: tuple[int, int]):
        ground, solid = view.ground, view.solid
        height, width = ground.image.shape[:2]
        zoom = min(box[0] / width, box[1] / height)
        self.size = (round(zoom * width), round(zoom * height))
        self.scale = FINE * self.size[0] / width * ground.pixels_per_metre  # supersampled pixels per metre
        self.corner = np.array([ground.extent[0], ground.extent[3]])
        self.body = _outline(body)
        image = 0.3 * 255 + 0.7 * np.asarray(ground.image, dtype=np.float64)
        if solid is not None:
            image[np.asarray(solid)] *= 0.45
        fine = (FINE * self.size[0], FINE * self.size[1])
        self.static = Image.fromarray(image.astype(np.uint8)).resize(fine, Image.Resampling.BICUBIC)
        self.marks = view.marks
        self._ruler(ImageDraw.Draw(self.static))

    def draw(self, recording: Recording, step: int) -> Image.Image:
        """Draw the map as it stands after ``step`` steps of an episode."""
        image = self.static.copy()
        pen = ImageDraw.Draw(image)
        styles = mark_styles(chain(self.marks, recording.named_marks))
        for mark in chain(self.marks, recording.marks[step] if recording.marks else ()):
            self._mark(pen, mark, *styles[mark.name])
        if len(styles) > 1:
            self._legend(pen, styles)
        trail = np.asarray(recording.planar[: step + 1], dtype=np.float64)
        for color, width in (("white", 5), (BLUE, 3)):
            pen.line(self._pixels(trail[:, :2]), fill=color, width=width * FINE, joint="curve")
        for position in _apart(trail[:, :2], APART * FINE / self.scale):
            self._dot(pen, position, 3, BLUE)
        self._dot(pen, trail[0, :2], 5, "white")
        ended = step == len(recording.action)
        color = COLORS[recording.outcome if ended else Outcome.RUNNING]
        pen.polygon(self._place(self.body, trail[-1]), outline="white", width=4 * FINE)
        pen.polygon(self._place(self.body, trail[-1]), outline=color, width=2 * FINE)
        length = 16 / self.scale * FINE
        pointer = length * np.array([[1.3, 0.0], [-0.7, 0.55], [-0.4, 0.0], [-0.7, -0.55]])
        pen.polygon(self._place(pointer, trail[-1]), fill=color, outline="white", width=FINE)
        return image.reduce(FINE)

    def _pixels(self, positions: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Convert world x and y, [N, 2] metres, to supersampled pixels."""
        columns, rows = ((positions - self.corner) * (self.scale, -self.scale)).T
        return list(zip(columns.tolist(), rows.tolist(), strict=True))

    def _place(self, shape: NDArray[np.float64], planar: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Place a shape at a pose: [K, 2] metres in the body frame -> supersampled pixels."""
        cos, sin = math.cos(planar[2]), math.sin(planar[2])
        return self._pixels(shape @ np.array([[cos, sin], [-sin, cos]]) + planar[:2])

    def _mark(self, pen: ImageDraw.ImageDraw, mark: Mark, color: str, corners: int) -> None:
        """Draw a mark as a dot or polygon, with an arrow if it has a direction."""
        pose = np.asarray(mark.planar.cpu(), dtype=np.float64)
        if not math.isnan(pose[2]):
            length = 26 / self.scale * FINE  # metres
            pen.polygon(self._place(ARROW * (length, 0.35 * length), pose), fill=color, outline=INK, width=FINE)
        self._dot(pen, pose[:2], 5, color, corners)

    def _dot(
        self, pen: ImageDraw.ImageDraw, position: NDArray[np.float64], radius: float, color: str, corners: int = 0
    ) -> None:
        (center,) = self._pixels(position[None])
        _shape(pen, center, radius, color, corners)

    def _legend(self, pen: ImageDraw.ImageDraw, styles: dict[str, tuple[str, int]]) -> None:
        """Draw a legend of the marks in the lower right corner."""
        fonts = {name: font(14 * FINE, name) for name in styles}
        left = FINE * (self.size[0] - 12) - max(pen.textlength(name, fonts[name]) for name in styles)
        for row, (name, (color, corners)) in enumerate(reversed(styles.items())):
            y = FINE * (self.size[1] - 16 - 20 * row)
            _shape(pen, (left - 12 * FINE, y), 5, color, corners)
            pen.text((left, y), name, INK, fonts[name], "lm", stroke_width=2 * FINE, stroke_fill="white")

    def _ruler(self, pen: ImageDraw.ImageDraw) -> None:
        """Draw a scale bar whose length is a round number of metres."""
        width, height = FINE * self.size[0], FINE * self.size[1]
        metres = 10.0 ** math.floor(math.log10(0.4 * width / self.scale))
        metres *= max(factor for factor in (1, 2, 5) if factor * metres * self.scale <= 0.4 * width)
        left, base = 12 * FINE, height - 12 * FINE
        for color, grow in (("white", 2 * FINE), (INK, 0)):
            box = (left - grow, base - 3 * FINE - grow, left + metres * self.scale + grow, base + grow)
            pen.rectangle(box, fill=color)
        place = (left, base - 8 * FINE)
        pen.text(place, f"{metres:g} m", INK, font(14 * FINE), "ls", stroke_width=2 * FINE, stroke_fill="white")


def _shape(pen: ImageDraw.ImageDraw, center: tuple[float, float], radius: float, color: str, corners: int) -> None:
    """Draw a dot, or a regular polygon of about its area with one corner up; positions are supersampled pixels."""
    if not corners:
        pen.circle(center, radius * FINE, fill=color, outline=INK, width=FINE)
        return
    angles = np.linspace(0, math.tau, corners, endpoint=False)
    points = 1.3 * radius * FINE * np.stack([np.sin(angles), -np.cos(angles)], -1) + center
    pen.polygon([(x, y) for x, y in points.tolist()], fill=color, outline=INK, width=FINE)


def _apart(positions: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Thin out a path, keeping positions at least ``least`` from the last one kept: [N, 2] -> [M, 2]."""
    taken = [positions[0]]
    for position in positions[1:]:
        if np.linalg.norm(position - taken[-1]) >= least:
            taken.append(position)
    return np.stack(taken)


def _outline(body: Body) -> NDArray[np.float64]:
    """Return the outline of a body seen from above: [K, 2] metres, body frame."""
    if isinstance(body, Box):
        return 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * body.size[:2]
    radius = body.radius if isinstance(body, Sphere) else body.cap_radius
    angles = np.linspace(0, math.tau, 32, endpoint=False)
    return radius * np.stack([np.cos(angles), np.sin(angles)], -1)
