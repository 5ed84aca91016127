"""Draws pictures of an occupancy: maps from above, and blocks seen from a corner."""

import math
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from splatrl.collision.voxels import Voxels
from splatrl.files import replacing

SOLID, FREE, NOTHING = "#3b4252", "#cfe8d5", "#f4f4f4"
COLORS = "viridis"
LIGHT = {"top": 1.0, "x": 0.78, "y": 0.58}
"""Brightness of the faces that face up, −x and −y."""
CUBE = {"top": [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], "x": [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)]}
CUBE["y"] = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
"""Corners of the same faces of the unit cube."""
SIDE = 900
"""Length of the longer side of a picture of blocks, pixels."""


def draw_maps(voxels: Voxels, path: Path, low: float, high: float) -> None:
    """Draw a height map and, beside it, a map of where a body between two heights is free, as a PNG.

    The height map shows, for each column, the top of the highest solid voxel below ``high`` + 1 m, so that a ceiling
    hides nothing. In the map on the right, a column is dark where something is solid between ``low`` and ``high``,
    green where nothing is but something solid lies below, and pale where nothing solid lies below either.

    Args:
        voxels: the solid voxels; may be empty.
        path: file to write, which ends in .png.
        low: lower end of the body, metres.
        high: upper end of the body, metres.

    Raises:
        ValueError: if ``low`` is not below ``high``.
    """
    if not low < high:
        raise ValueError(f"low: expected a height below high ({high} m), got {low} m")
    bottom, top, ceiling = (_layer(voxels, z) for z in (low, high - 1e-9, high + 1.0))
    body = voxels.occupied[:, :, bottom : top + 1].any(2)
    under = voxels.occupied[:, :, :bottom].any(2)
    kinds = np.where(body, 2, np.where(under, 1, 0))
    (left, front, _), (right, back, _) = voxels.bounds
    size = right - left or 1.0, back - front or 1.0
    width = 5.2 * min(1.6, max(0.7, size[0] / size[1]))
    figure = Figure(figsize=(2 * width + 1.6, 5.4), dpi=120, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    extent = (left, left + size[0], front, front + size[1])
    heights = _heights(voxels, ceiling)
    image = axes[0].imshow(heights.T, origin="lower", extent=extent, cmap=COLORS, interpolation="nearest")
    axes[0].set_title("height of solid voxels (m)")
    figure.colorbar(image, ax=axes[0], shrink=0.8)
    colors = ListedColormap([NOTHING, FREE, SOLID])
    axes[1].imshow(kinds.T, origin="lower", extent=extent, cmap=colors, vmin=0, vmax=2, interpolation="nearest")
    axes[1].set_title(f"free space (green) between {low:g} and {high:g} m")
    for axis in axes:
        axis.set_xlabel("x (m)")
        axis.set_facecolor(NOTHING)
    axes[0].set_ylabel("y (m)")
    with replacing(path) as stream:
        canvas.print_png(stream)


def draw_blocks(voxels: Voxels, path: Path, below: float | None = None, quarter_turns: int = 0) -> None:
    """Draw the solid voxels as blocks seen from above a corner, coloured by height, as a PNG.

    The view is isometric, from the corner of lowest x and y. Only faces towards the viewer are drawn, back to front.

    Args:
        voxels: the solid voxels; may be empty.
        path: file to write, which ends in .png.
        below: height at which the scene is cut open, metres; None cuts nothing.
        quarter_turns: counter-clockwise quarter turns of the scene before it is drawn: 1 looks from the highest y, 2
            from the highest x and y, 3 from the highest x.
    """
    occupied = voxels.occupied
    if below is not None:
        occupied = occupied[:, :, : _layer(voxels, below)]
    occupied = np.rot90(occupied, quarter_turns)
    shape = np.array(occupied.shape)
    across, up = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    project = np.array([[across, -across, 0.0], [-up, -up, -1.0]])  # a step along x, y and z, as right and down
    corners = np.stack(np.meshgrid(*[(0, extent) for extent in shape], indexing="ij"), -1).reshape(-1, 3) @ project.T
    first, last = corners.min(0), corners.max(0)
    scale = 2 * (SIDE - 40) / max(*(last - first), 1.0)
    width, height = ((last - first) * scale + 80).tolist()
    image = Image.new("RGB", (round(width), round(height)), "white")
    pen = ImageDraw.Draw(image)
    cells, squares, colors = _faces(occupied)
    places = ((cells[:, None] + squares) @ project.T - first) * scale + 40
    for polygon, color in zip(places.reshape(-1, 8).tolist(), colors.tolist(), strict=True):
        pen.polygon(polygon, fill=tuple(color))
    with replacing(path) as stream:
        image.reduce(2).save(stream, "PNG")


def _layer(voxels: Voxels, z: float) -> int:
    """Return the index of the layer that holds a height, clamped to the grid and the first layer above it."""
    return min(max(math.floor(z / voxels.resolution + 1e-6) - voxels.origin_key[2], 0), voxels.occupied.shape[2])


def _heights(voxels: Voxels, ceiling: int) -> NDArray[np.float64]:
    """Return the top of each column's highest solid voxel below a layer, metres: [X, Y], NaN where there is none."""
    column = voxels.occupied[:, :, :ceiling]
    if column.size == 0:
        return np.full(column.shape[:2], np.nan)
    highest = column.shape[2] - column[:, :, ::-1].argmax(2)
    return np.where(column.any(2), (highest + voxels.origin_key[2]) * voxels.resolution, np.nan)


def _faces(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]:
    """Return the visible faces, farthest first: cells [M, 3], corners relative to them [M, 4, 3], colours [M, 3]."""
    padded = np.pad(occupied, 1)
    beside = {"top": padded[1:-1, 1:-1, 2:], "x": padded[:-2, 1:-1, 1:-1], "y": padded[1:-1, :-2, 1:-1]}
    ramp = 255 * colormaps[COLORS](np.linspace(0.0, 1.0, max(occupied.shape[2], 1)))[:, :3]
    cells, squares, colors = [], [], []
    for side, neighbour in beside.items():
        seen = np.argwhere(occupied & ~neighbour)
        cells.append(seen)
        squares.append(np.broadcast_to(CUBE[side], (len(seen), 4, 3)))
        colors.append(ramp[seen[:, 2]] * LIGHT[side])
    cell = np.concatenate(cells)
    order = np.argsort(cell[:, 2] - cell[:, 0] - cell[:, 1], kind="stable")
    return cell[order], np.concatenate(squares)[order], np.concatenate(colors)[order].astype(np.uint8)
