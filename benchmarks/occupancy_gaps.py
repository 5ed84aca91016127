"""Draws the gaps in the walls of an occupancy, each wall as seen from the middle of the scene."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from occupancy_truth import BEFORE, BEHIND, Truth

from splatrl.collision import Occupancy
from splatrl.files import replacing

HEIGHT = 2.2
"""Height above the floor up to which walls are drawn, metres."""


def draw_gaps(truth: Truth, path: Path) -> None:
    """Draw for each wall where solid voxels lie on the paths of the moves through it."""
    voxels = Occupancy.from_scene(truth.scene)
    (left, front, bottom), _ = voxels.bounds
    figure = Figure(figsize=(4.2 * len(truth.walls), 3.0), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    for axes, place in zip(figure.subplots(1, len(truth.walls)), truth.walls, strict=True):
        side, axis = place.side, abs(place.side) - 1
        sign = 1 if side > 0 else -1
        ends = sorted((place.plane - sign * BEFORE, place.plane + sign * BEHIND))
        first, last = (max(round(end / voxels.resolution) - voxels.origin_key[axis], 0) for end in ends)
        wall = voxels.occupied[(slice(None),) * axis + (slice(first, last),)].any(axis)
        start = front if axis == 0 else left
        high = bottom + wall.shape[1] * voxels.resolution
        extent = (start, start + wall.shape[0] * voxels.resolution, bottom, high)
        colors = ListedColormap(["#d1495b", "#cfd8dc"])
        axes.imshow(wall.T, origin="lower", extent=extent, cmap=colors, vmin=0, vmax=1, interpolation="nearest")
        for height in truth.whole:
            axes.axhline(height, color="black", linewidth=0.6)
        axes.set_ylim(bottom, HEIGHT)
        low, top = (round((z - bottom) / voxels.resolution) for z in truth.gappy)
        along = (round((at - start) / voxels.resolution) for at in place.span)
        open_ = ~wall[slice(*along), low:top]
        axes.set_title(f"towards {'+' if side > 0 else '−'}{'xyz'[axis]}: {100 * open_.mean():.1f} % open")
        axes.set_xlabel(f"{'yx'[axis]}, m")
    figure.suptitle(f"{truth.scene.name}: red is open; per cent for z from {truth.gappy[0]} to {truth.gappy[1]} m")
    with replacing(path) as stream:
        canvas.print_png(stream)
