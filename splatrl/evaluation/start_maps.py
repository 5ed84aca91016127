"""Maps of an evaluation: from which starts a policy reaches its goal, over a picture of the ground."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray
from torch import Tensor

from splatrl.envs.tasks.base import Mark
from splatrl.evaluation.figure_style import DPI, GOAL, INK, MISSED, PARTLY, REACHED, mark_styles, save_figure
from splatrl.evaluation.topdown import MapView, TopDown

MAP_SIZE = 5.8
"""Longer side of a map, inches."""
OVERVIEW = 2.3
"""Longer side of the overview of the whole place beside a map, inches."""
BESIDE = 0.2
"""Space between a map and what stands beside it, inches."""
SCALE, LABELS = 0.2, 0.85
"""Width of a colour scale and of its labels, inches."""
MOST_ARROWS = 20
"""Maximum number of positions along the longer side of a map whose arrows can still be told apart."""
FOOT = 1.1
"""Space below a map for its axis labels and legend, inches."""
NO_PATH = "goal cannot be reached"
"""Legend of positions from which no path leads to the goal."""
ARROW = np.array([[0.2, 0.22], [0.68, 0.42], [0.68, 1.0], [1.0, 0.0], [0.68, -1.0], [0.68, -0.42], [0.2, -0.22]])
"""Outline of an arrow along +x that is thin at its tail, [7, 2]: x in arrow lengths, y in half widths of the head."""


def start_map(
    planar: Tensor,
    success: Tensor,
    view: MapView,
    path: Path,
    blocked: Tensor | None = None,
    cut_off: Tensor | None = None,
    every: int | None = None,
) -> None:
    """Draw every start pose as an arrow, coloured by whether the goal was reached from it.

    The headings at one position form a rosette around it. Where positions are too close for legible arrows, only an
    evenly spread subset is drawn.

    Args:
        planar: [N, 3] float64, x and y in metres and yaw in radians of the starts, world frame; a pose can occur more
            than once.
        success: [N] bool.
        view: background and marks of the map.
        path: file of the figure; its suffix sets the format.
        blocked: [M, 2] x and y of positions at which the body fits in no heading, world frame, metres.
        cut_off: [M, 2] likewise, of positions at which it fits, but from which no path leads to the goal.
        every: number of poses in the start set, for the title; None if all of them are given.
    """
    poses, rate = _mean_by_row(planar, success)
    rows = len(poses), int((rate == 1).sum())
    cell = max(_legible(_spacing(poses, view.ground), view.ground), _side(view.ground) / MOST_ARROWS)
    some = _thinned(poses[:, :2], cell)
    poses, rate = poses[some], rate[some]
    headings = np.unique(poses[:, :2], axis=0, return_counts=True)[1].max()
    length = (0.5 if headings > 2 else 0.85) * cell
    half_width = min(0.14 * length, 0.75 * length * math.pi * 0.68 / headings)
    kinds = [
        (rate == 1, REACHED, "goal reached"),
        ((rate > 0) & (rate < 1), PARTLY, "reached in some episodes"),
        (rate == 0, MISSED, "not reached"),
    ]
    figure, axes = _map(view, colourful=True)
    handles: list[Patch | Line2D] = []
    for order, (mask, color, label) in enumerate(kinds):
        if mask.any():
            arrows = list(_arrows(poses[mask], length, half_width))
            axes.add_collection(
                PolyCollection(arrows, facecolors=color, edgecolors="white", linewidths=0.15, zorder=3 + order)
            )
            handles.append(Patch(color=color, label=label))
    handles += _positions(axes, blocked, "x", "body does not fit") + _positions(axes, cut_off, ".", NO_PATH)
    handles += _marks(axes, view.marks, length)
    title = f"goal reached from {rows[1]:,} of {rows[0]:,} start poses ({rows[1] / rows[0]:.1%})"
    notes = []
    if every is not None and every > rows[0]:
        notes.append(f"{rows[0]:,} of {every:,} tried")
    if not some.all():
        notes.append(f"{some.sum():,} of them drawn")
    axes.set_title(f"{title}\n{', '.join(notes)}" if notes else title, fontsize=10)
    _finish(figure, handles, view, path)


def success_map(
    planar: Tensor,
    success: Tensor,
    view: MapView,
    path: Path,
    starts: str = "all starts",
    cut_off: Tensor | None = None,
) -> None:
    """Draw the success rate by start position as coloured cells, averaged over headings and repetitions.

    Positions on a lattice get one cell each; other positions are pooled into 20 cells along the picture's longer side.

    Args:
        planar: [N, 3] float64, x and y in metres and yaw in radians of the starts, world frame.
        success: [N] bool.
        view: background and marks of the map.
        path: file of the figure; its suffix sets the format.
        starts: which starts these are, for the title.
        cut_off: [M, 2] x and y of positions from which no path leads to the goal, world frame, metres.
    """
    positions = np.asarray(planar, dtype=np.float64)[:, :2]
    cell, corner = _spacing(positions, view.ground), positions.min(0)
    cells, rate = _mean_by_row(((positions - corner) / cell).round(), success)
    centers = corner + cells * cell
    half = 0.43 * _legible(cell, view.ground)
    squares = centers[:, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    figure, axes = _map(view, colourful=False)
    heat = PolyCollection(
        squares, array=rate, cmap="viridis", clim=(0, 1), edgecolors="white", linewidths=0.4, zorder=3
    )
    axes.add_collection(heat)
    scale = _inset(axes, BESIDE, SCALE, axes.bbox.height / DPI)
    bar = figure.colorbar(heat, cax=scale, format=PercentFormatter(1.0, decimals=0))
    bar.set_label("success, mean over headings")
    mean = np.asarray(success, dtype=np.float64).mean()
    axes.set_title(f"success by start position ({starts} {mean:.1%})", fontsize=10)
    handles = _positions(axes, cut_off, ".", NO_PATH) + _marks(axes, view.marks, half)
    _finish(figure, handles, view, path)


def _mean_by_row(rows: Tensor | NDArray[np.float64], values: Tensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distinct rows [M, D] of [N, D], and the mean [M] of the values [N] of each."""
    distinct, row = np.unique(np.asarray(rows, dtype=np.float64).round(6), axis=0, return_inverse=True)
    row = row.reshape(-1)
    return distinct, np.bincount(row, np.asarray(values, dtype=np.float64)) / np.bincount(row)


def _spacing(positions: NDArray[np.float64], ground: TopDown) -> float:
    """Return the distance between neighbouring positions [N, 2] of a lattice, or a legible size without one; metres."""
    side = _side(ground)
    gaps = np.concatenate([np.diff(np.unique(positions[:, axis].round(6))) for axis in (0, 1)])
    spacing = gaps.min() if len(gaps) else side
    return float(spacing) if spacing > side / 60 else side / 20


def _legible(spacing: float, ground: TopDown) -> float:
    """Limit the size of what is drawn at a position, metres: a few positions far apart get no huge arrows or cells."""
    return min(spacing, _side(ground) / 8)


def _side(ground: TopDown) -> float:
    """Return the longer side of the picture, metres."""
    left, right, bottom, top = ground.extent
    return max(right - left, top - bottom)


def _thinned(positions: NDArray[np.float64], cell: float) -> NDArray[np.bool_]:
    """Choose which poses to draw: in each square cell, those at the position nearest its middle; [N, 2] -> [N] bool."""
    distinct, row = np.unique(positions.round(6), axis=0, return_inverse=True)
    scaled = (distinct - distinct.min(0)) / cell + 1e-6  # so that lattice neighbours get different cells
    square, away = np.floor(scaled), np.abs(scaled - np.floor(scaled) - 0.5).max(1)
    order = np.lexsort((away, square[:, 1], square[:, 0]))
    first = np.append(True, (np.diff(square[order], axis=0) != 0).any(1))
    drawn = np.zeros(len(distinct), bool)
    drawn[order[first]] = True
    return drawn[row.reshape(-1)]


def _arrows(planar: NDArray[np.float64], length: float, half_width: float) -> NDArray[np.float64]:
    """Return the outlines of arrows that start at poses: [N, 3] x, y and yaw -> [N, 7, 2] metres."""
    cos, sin = np.cos(planar[:, 2]), np.sin(planar[:, 2])
    turn = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)  # for row vectors
    return planar[:, None, :2] + (ARROW * (length, half_width)) @ turn


def _map(view: MapView, colourful: bool) -> tuple[Figure, Axes]:
    """Make axes in metres over a picture of the ground, faded so that drawings stand out."""
    ground, solid = view.ground, view.solid
    left, right, bottom, top = ground.extent
    inches = MAP_SIZE / max(right - left, top - bottom)
    width, height = inches * (right - left), inches * (top - bottom)
    page_width, page_height = max(width, 4.8) + 1.6, height + FOOT + 0.4
    figure = Figure(figsize=(page_width, page_height), dpi=DPI)
    axes = figure.add_axes(
        (0.5 - 0.5 * width / page_width, FOOT / page_height, width / page_width, height / page_height)
    )
    image = np.asarray(ground.image, dtype=np.float64) / 255
    image = image if colourful else image @ np.array([0.299, 0.587, 0.114])[:, None] * np.ones(3)
    axes.imshow(0.5 + 0.5 * image, extent=ground.extent, interpolation="antialiased")
    if solid is not None and solid.any():
        mask = np.pad(np.asarray(solid, dtype=np.float64), 1)  # padded so that outlines close at the picture's edge
        pixel = (right - left) / solid.shape[1]
        x = left + (np.arange(-1, solid.shape[1] + 1) + 0.5) * pixel
        y = top - (np.arange(-1, solid.shape[0] + 1) + 0.5) * pixel
        axes.contourf(x, y, mask, levels=[0.5, 2], colors=["none"], hatches=["//////"], zorder=2)
        axes.contour(x, y, mask, levels=[0.5], colors=[INK], linewidths=1.0, zorder=2)
    axes.set(xlabel="x (m)", ylabel="y (m)", xlim=(left, right), ylim=(bottom, top))
    if view.overview is not None:
        _overview(axes, view.overview, ground, BESIDE if colourful else 2 * BESIDE + SCALE + LABELS)
    return figure, axes


def _inset(axes: Axes, away: float, width: float, height: float) -> Axes:
    """Make axes on the right of a map, ``away`` from it, that begin at its top; all in inches."""
    box = axes.bbox
    across, up = box.width / DPI, box.height / DPI
    return axes.inset_axes((1 + away / across, 1 - height / up, width / across, height / up))


def _overview(axes: Axes, overview: TopDown, ground: TopDown, away: float) -> None:
    """Draw an overview beside a map, ``away`` inches from it, with the map's window outlined in it."""
    left, right, bottom, top = overview.extent
    inset = _inset(axes, away, OVERVIEW, OVERVIEW)
    inset.imshow(np.asarray(overview.image), extent=overview.extent, interpolation="antialiased")
    x0, x1, y0, y1 = ground.extent
    inset.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="white", linewidth=3))
    inset.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=GOAL, linewidth=1.5))
    inset.set(xticks=[], yticks=[], xlim=(left, right), ylim=(bottom, top), anchor="NW")
    inset.set_xlabel(f"overview, {right - left:.0f} × {top - bottom:.0f} m", fontsize=8)  # a title could meet the map's


def _positions(axes: Axes, places: Tensor | None, marker: str, label: str) -> list[Patch | Line2D]:
    """Mark positions where no episode begins, [M, 2] metres; return the legend's entries."""
    if places is None or not len(places):
        return []
    x, y = np.asarray(places).T
    look: dict[str, Any] = {"color": INK, "marker": marker, "linestyle": "none", "markeredgewidth": 1.2}
    halo = [withStroke(linewidth=3, foreground="white")]
    axes.plot(x, y, markersize=4, zorder=2.5, path_effects=halo, **look)
    return [Line2D([], [], markersize=5, label=label, **look)]


def _marks(axes: Axes, marks: Sequence[Mark], length: float) -> list[Patch | Line2D]:
    """Draw each mark in the look of its name, with an arrow if it has a direction; return the legend's entries."""
    looks: dict[str, dict[str, Any]] = {
        name: {"color": color, "marker": (corners, 0, 0) if corners else "o", "markeredgecolor": INK, "markersize": 6}
        for name, (color, corners) in mark_styles(marks).items()
    }
    for mark in marks:
        pose, look = np.asarray(mark.planar.cpu(), dtype=np.float64)[None], looks[mark.name]
        if not np.isnan(pose[0, 2]):
            arrow = list(_arrows(pose, 1.2 * length, 0.4 * length))
            axes.add_collection(PolyCollection(arrow, facecolors=look["color"], edgecolors=INK, linewidths=1, zorder=9))
        axes.plot(*pose[0, :2], zorder=9, **look)
    return [Line2D([], [], label=name, linewidth=0, **look) for name, look in looks.items()]


def _finish(figure: Figure, handles: list[Patch | Line2D], view: MapView, path: Path) -> None:
    if view.solid is not None and view.solid.any():
        handles.append(Patch(facecolor="none", edgecolor=INK, hatch="//////", label="solid at body height"))
    top = (FOOT - 0.5) / figure.get_figheight()
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, top), ncols=3, frameon=False, fontsize=9)
    save_figure(figure, path)
