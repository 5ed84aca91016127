"""Picture for judging the terrain that physics derives from a scene: ground and boxes, drawn over the scene."""

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from torch import Tensor

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.evaluation.topdown import top_down
from splatrl.files import replacing
from splatrl.physics.survey import Surveyed
from splatrl.renderers import NativeRenderer
from splatrl.scenes.gaussians import Gaussians

AROUND = 0.5
"""Margin of the scene that is shown around robots' bounds and boxes, metres."""
ABOVE = 0.6
"""Height above the tallest box at which the scene is cut open, metres."""
SIDE = 720
"""Longer side of a view, pixels."""
LINES = 0.25
"""Spacing of the lines of the ground's grid, metres."""
PITCH, FOV = math.radians(42.0), math.radians(45.0)
"""Downward pitch and horizontal field of view of the oblique view, radians."""
SKEW = math.radians(25.0)
"""Angle between the oblique view's side and the side with the fewest boxes, radians."""
COLORS = "plasma"
EDGES = [(a, b) for a, b in product(range(8), repeat=2) if a < b and (a ^ b).bit_count() == 1]


def draw_terrain(
    gaussians: Gaussians,
    surveyed: Surveyed,
    lower: Sequence[float],
    upper: Sequence[float],
    path: Path,
    antialiased: bool = True,
) -> None:
    """Draw ground and boxes over a scene, from above and obliquely, as PNG.

    The scene is drawn without its view-dependent colours. Outlines of boxes are coloured by the height of their tops
    above the ground; the ground is drawn as a 25 cm grid, and dashed lines mark the bounds.

    Args:
        gaussians: the scene's Gaussians, world frame.
        surveyed: ground and boxes that physics uses.
        lower: smallest x and y to which robots go, metres.
        upper: largest x and y, metres.
        path: file to write, ending in .png.
        antialiased: whether to render the scene antialiased.
    """
    gaussians = gaussians.replace(sh=gaussians.sh[:, :1])  # each picture copies what it shows of a scene
    boxes = surveyed.terrain.boxes.numpy()
    floor = float(surveyed.ground.height(0.5 * (np.array(lower) + np.array(upper))))
    corners = np.stack([boxes[:, :2] - boxes[:, 3:5], boxes[:, :2] + boxes[:, 3:5]])
    low = np.minimum(lower, corners[0].min(0, initial=np.inf)) - AROUND
    high = np.maximum(upper, corners[1].max(0, initial=-np.inf)) + AROUND
    tops = boxes[:, 2] + boxes[:, 5] - surveyed.ground.height(boxes[:, :2])
    cut = floor + max(float(tops.max(initial=0.0)), 0.0) + ABOVE
    scale = tops.max(initial=0.1)
    colors = colormaps[COLORS](tops / scale)
    sides = [min(max((high[0] - low[0]) / (high[1] - low[1]), 0.6), 2.4), 4 / 3]  # relative to their height
    figure = Figure(figsize=(3.0 + 4.5 * sum(sides), 6.0), dpi=110, layout="compressed")
    canvas = FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=sides)

    def make(shown: Gaussians) -> NativeRenderer:
        return NativeRenderer(shown, antialiased)

    ground = top_down(gaussians, low.tolist(), high.tolist(), cut, SIDE, make)
    left.imshow(ground.image.numpy(), extent=ground.extent)
    for first, last, color in zip(corners[0], corners[1], colors, strict=True):
        left.add_patch(Rectangle((first[0], first[1]), *(last - first), fill=False, edgecolor=color, linewidth=1.2))
    size = np.subtract(upper, lower)
    left.add_patch(Rectangle((lower[0], lower[1]), *size, fill=False, edgecolor="white", linestyle="--", linewidth=1.0))
    left.set_title(f"{len(boxes)} boxes; dashed: walkable area")
    left.set_xlabel("x (m)")
    left.set_ylabel("y (m)")
    shown = make(gaussians[gaussians.means[:, 2] < cut])
    _oblique(right, shown, surveyed, low, high, colors, (np.array(lower), np.array(upper)))
    right.set_title(
        f"ground at {floor:+.3f} m in the middle of the walkable area,\n"
        f"tilted by {math.degrees(surveyed.ground.tilt):.2f}°; 25 cm grid"
    )
    tall = ScalarMappable(Normalize(0.0, float(scale)), COLORS)
    figure.colorbar(tall, ax=[left, right], shrink=0.7, aspect=30, label="height of box tops above the ground (m)")
    with replacing(path) as stream:
        canvas.print_png(stream)


def _oblique(
    axes: Axes,
    renderer: NativeRenderer,
    surveyed: Surveyed,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    colors: NDArray[np.float64],
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Draw an oblique view of the scene from above, with the ground's grid and the edges of the boxes."""
    middle = 0.5 * (low + high)
    target = np.append(middle, surveyed.ground.height(middle))
    width, height = SIDE, round(0.75 * SIDE)
    away = 0.62 * float(np.linalg.norm(high - low)) / math.tan(0.5 * FOV)
    yaw = _open_side(surveyed.terrain.boxes.numpy(), middle) + SKEW
    eye = target + away * np.array([math.cos(PITCH) * math.cos(yaw), math.cos(PITCH) * math.sin(yaw), math.sin(PITCH)])
    pose, K = look_at(eye.tolist(), target.tolist()), intrinsics(FOV, width, height)
    image = renderer.pixels(Cameras(pose[None], K, width, height))[0]
    axes.imshow(image.numpy())
    axes.set_axis_off()
    axes.add_collection(
        LineCollection(_seen(_grid(surveyed, *bounds), pose, K), colors="white", linewidths=0.5, alpha=0.6)
    )
    boxes = surveyed.terrain.boxes.numpy()
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    corners = boxes[:, None, :3] + signs * boxes[:, None, 3:]
    edges = corners[:, EDGES]  # [N, 12, 2, 3]
    for lines, color in zip(edges, colors, strict=True):
        axes.add_collection(LineCollection(_seen(lines, pose, K), colors=[color], linewidths=1.0))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)


def _open_side(boxes: NDArray[np.float64], middle: NDArray[np.float64]) -> float:
    """Return the direction from the middle that points away from most boxes, by volume, radians."""
    weight = boxes[:, 3:].prod(1)
    x, y = weight @ (middle - boxes[:, :2]) if len(boxes) else (0.0, -1.0)
    return math.atan2(y, x)


def _grid(surveyed: Surveyed, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the grid lines on the ground within bounds: [N, 2, 3], metres."""
    lines = []
    for axis in range(2):
        for at in np.linspace(lower[axis], upper[axis], 1 + round((upper[axis] - lower[axis]) / LINES)):
            ends = np.array([lower, upper], np.float64)
            ends[:, axis] = at
            lines.append(np.append(ends, surveyed.ground.height(ends)[:, None], 1))
    return np.array(lines)


def _seen(lines: NDArray[np.float64], camera_to_world: Tensor, K: Tensor) -> list[NDArray[np.float64]]:
    """Project lines [N, 2, 3], without those not wholly in front of the camera: [2, 2] pixels each."""
    pose = camera_to_world.double().numpy()
    local = (lines - pose[:3, 3]) @ pose[:3, :3]
    local = local[(local[..., 2] > 0.05).all(1)]
    pixels = local @ K.double().numpy().T
    return list(pixels[..., :2] / pixels[..., 2:])
