"""Figures of a finished training: its learning curve, and from which starts it succeeds."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter
from numpy.typing import NDArray
from torch import Tensor

from splatrl.envs.tasks.base import Mark
from splatrl.evaluation.topdown import MapView, TopDown
from splatrl.files import replacing

REACHED, PARTLY, MISSED = "#009e73", "#e69f00", "#d55e00"  # distinguishable with any colour vision
GOAL, TEST, BLUE, PURPLE, INK = "#e0409f", "#f0e442", "#0072b2", "#8a5a99", "#222222"
MARKS = ((GOAL, 0), (TEST, 4), ("#56b4e9", 3))
"""Colour and number of corners (0 is a dot) of marks, assigned to their names in order of first appearance."""
DPI = 160
MAP_SIZE = 5.8
"""Longer side of a map, inches."""
OVERVIEW = 0.4
"""Size of the overview of the whole place beside a map, as a fraction of the map's sides."""
MOST_ARROWS = 20
"""Maximum number of positions along the longer side of a map whose arrows can still be told apart."""
FOOT = 1.1
"""Space below a map for its axis labels and legend, inches."""
ARROW = np.array([[0.2, 0.22], [0.68, 0.42], [0.68, 1.0], [1.0, 0.0], [0.68, -1.0], [0.68, -0.42], [0.2, -0.22]])
"""Outline of an arrow along +x that is thin at its tail, [7, 2]: x in arrow lengths, y in half widths of the head."""


def learning_curve(history: Sequence[Mapping[str, float]], path: Path) -> None:
    """Plot success, curriculum level and return over the frames of a training.

    Args:
        history: one row per iteration with ``frames`` and any of ``success``, ``test_success``, ``level`` (from 0),
            ``return`` and ``episodes``; missing values and NaN leave a gap.
        path: file of the figure; its suffix sets the format.
    """
    figure = Figure(figsize=(7.2, 5.4), dpi=DPI, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    frames, episodes = column(history, "frames"), np.nan_to_num(column(history, "episodes"), nan=1.0)
    tests = column(history, "test_success")
    levels = above.twinx()
    level = column(history, "level") + 1
    begun, held = np.append(0.0, frames), np.append(level[:1], level)  # a row's level applies to the frames before it
    levels.fill_between(begun[: len(held)], 0, held, step="pre", color=PURPLE, alpha=0.12, linewidth=0)
    levels.step(begun[: len(held)], held, where="pre", color=PURPLE, linewidth=1.2)
    levels.set_ylim(0, max([1.0, *level[~np.isnan(level)]]) * 1.05)
    levels.yaxis.set_major_locator(MaxNLocator(integer=True))
    levels.set_ylabel("curriculum level", color=PURPLE)
    levels.tick_params(axis="y", colors=PURPLE)
    above.set_zorder(levels.get_zorder() + 1)
    above.patch.set_visible(False)
    _curve(above, frames, column(history, "success"), episodes, BLUE)
    above.plot(frames, tests, "D", color=INK, markersize=4.5, markerfacecolor=TEST, clip_on=False)
    above.set(ylabel="success", ylim=(-0.02, 1.02))
    above.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    handles = [
        Line2D([], [], color=BLUE, linewidth=2, label="training episodes"),
        Line2D([], [], color=INK, marker="D", markersize=4.5, markerfacecolor=TEST, linewidth=0, label="test"),
        Line2D([], [], color=PURPLE, linewidth=1.2, label="curriculum level"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    _curve(below, frames, column(history, "return"), episodes, BLUE)
    below.set(xlabel="frames", ylabel="episode return")
    below.xaxis.set_major_formatter(EngFormatter(sep=""))
    for axes in (above, below):
        axes.grid(color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.margins(x=0.01)
    below.set_xlim(left=0)
    save_figure(figure, path)


def scene_bars(names: Sequence[str], success: Sequence[float], path: Path) -> None:
    """Plot the success rate in each of several scenes as bars, the best scene first.

    Args:
        names: names of the scenes.
        success: success rates in [0, 1], one per scene.
        path: file of the figure; its suffix sets the format.
    """
    order = np.argsort(-np.asarray(success), kind="stable")
    figure = Figure(figsize=(7.2, 0.9 + 0.19 * len(names)), dpi=DPI, layout="constrained")
    axes, rates = figure.subplots(), np.asarray(success)[order]
    axes.barh(np.arange(len(names)), rates, 0.72, color=BLUE)
    for row, rate in enumerate(rates):
        label = axes.text(rate + 0.008, row, f"{rate:.0%}", va="center", fontsize=8, color=INK)
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1})  # covers the line of the average
    axes.axvline(float(np.mean(rates)), color=INK, linewidth=1, linestyle="--", zorder=0)
    axes.set_title(f"success rate in {len(names)} scenes, {np.mean(rates):.1%} on average", fontsize=11)
    axes.set_yticks(np.arange(len(names)), [names[i] for i in order], fontsize=8)
    axes.set(xlim=(0, 1.08), ylim=(len(names) - 0.4, -0.6), xlabel="success")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    save_figure(figure, path)


def start_map(
    planar: Tensor,
    success: Tensor,
    view: MapView,
    path: Path,
    blocked: Tensor | None = None,
) -> None:
    """Draw every start pose as an arrow, coloured by whether the goal was reached from it.

    The headings at one position form a rosette around it. Where positions are too close for legible arrows, only an
    evenly spread subset is drawn.

    Args:
        planar: [N, 3] x and y in metres and yaw in radians of the starts; a pose can occur more than once.
        success: [N] bool.
        view: background and marks of the map.
        path: file of the figure; its suffix sets the format.
        blocked: [M, 2] x and y of positions at which the body does not fit in any heading, metres.
    """
    poses, rate = _mean_by_row(planar, success)
    rows = len(poses), int((rate == 1).sum())
    cell = max(_spacing(poses, view.ground), _side(view.ground) / MOST_ARROWS)
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
    if blocked is not None and len(blocked):
        x, y = np.asarray(blocked).T
        halo = [withStroke(linewidth=3, foreground="white")]
        axes.plot(x, y, "x", color=INK, markersize=4, markeredgewidth=1.2, zorder=2.5, path_effects=halo)
        handles.append(Line2D([], [], color=INK, marker="x", markersize=5, linewidth=0, label="body does not fit"))
    handles += _marks(axes, view.marks, length)
    title = f"goal reached from {rows[1]:,} of {rows[0]:,} start poses ({rows[1] / rows[0]:.1%})"
    axes.set_title(title if some.all() else f"{title}\n{some.sum():,} of them drawn", fontsize=10)
    _finish(figure, handles, view, path)


def success_map(planar: Tensor, success: Tensor, view: MapView, path: Path) -> None:
    """Draw the success rate by start position as coloured cells, averaged over headings and repetitions.

    Positions on a lattice get one cell each; other positions are pooled into 20 cells along the picture's longer side.

    Args:
        planar: [N, 3] x and y in metres and yaw in radians of the starts.
        success: [N] bool.
        view: background and marks of the map.
        path: file of the figure; its suffix sets the format.
    """
    positions = np.asarray(planar, dtype=np.float64)[:, :2]
    cell, corner = _spacing(positions, view.ground), positions.min(0)
    cells, rate = _mean_by_row(((positions - corner) / cell).round(), success)
    centers = corner + cells * cell
    half = 0.43 * cell
    squares = centers[:, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    figure, axes = _map(view, colourful=False)
    heat = PolyCollection(
        squares, array=rate, cmap="viridis", clim=(0, 1), edgecolors="white", linewidths=0.4, zorder=3
    )
    axes.add_collection(heat)
    scale = axes.inset_axes((1.03, 0.0, 0.04, 1.0))
    bar = figure.colorbar(heat, cax=scale, format=PercentFormatter(1.0, decimals=0))
    bar.set_label("success, mean over headings")
    mean = np.asarray(success, dtype=np.float64).mean()
    axes.set_title(f"success by start position (all starts {mean:.1%})", fontsize=10)
    _finish(figure, _marks(axes, view.marks, 0.5 * cell), view, path)


def mark_styles(marks: Iterable[Mark]) -> dict[str, tuple[str, int]]:
    """Assign a look to the marks of each name: colour and number of corners."""
    names = dict.fromkeys(mark.name for mark in marks)
    return dict(zip(names, itertools.cycle(MARKS)))


def column(history: Sequence[Mapping[str, float]], key: str) -> NDArray[np.float64]:
    return np.array([row.get(key, math.nan) for row in history], dtype=np.float64)


def _curve(
    axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64], color: str
) -> None:
    """Plot raw values faintly, and their weighted running mean over 1/12 of the rows; few rows are marked by dots."""
    known = ~np.isnan(y)
    x, y, weights = x[known], y[known], weights[known]
    axes.plot(x, y, ".-", color=color, linewidth=0.8, markersize=4, alpha=0.35)
    rows = math.ceil(len(y) / 12)
    sums = [np.convolve(values, np.ones(rows))[: len(y)] for values in (weights * y, weights)] if len(y) else [y, y]
    axes.plot(x, sums[0] / sums[1], color=color, linewidth=2, marker="o" if rows == 1 else "", markersize=5)


def _mean_by_row(rows: Tensor | NDArray[np.float64], values: Tensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distinct rows, and the mean value of each."""
    distinct, row = np.unique(np.asarray(rows, dtype=np.float64).round(6), axis=0, return_inverse=True)
    row = row.reshape(-1)
    return distinct, np.bincount(row, np.asarray(values, dtype=np.float64)) / np.bincount(row)


def _spacing(positions: NDArray[np.float64], ground: TopDown) -> float:
    """Return the distance between neighbouring lattice positions, or a legible size if there is no lattice."""
    side = _side(ground)
    gaps = np.concatenate([np.diff(np.unique(positions[:, axis].round(6))) for axis in (0, 1)])
    spacing = gaps.min() if len(gaps) else side
    return float(min(spacing, side / 8)) if spacing > side / 60 else side / 20


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
    """Return the outlines of arrows that start at poses: [N, 3] -> [N, 7, 2]."""
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
        _overview(axes, view.overview, ground, 1.05 if colourful else 1.24)
    return figure, axes


def _overview(axes: Axes, overview: TopDown, ground: TopDown, place: float) -> None:
    """Draw an overview beside a map, ``place`` map widths from its left edge, with the map's window outlined in it."""
    left, right, bottom, top = overview.extent
    inset = axes.inset_axes((place, 1 - OVERVIEW, OVERVIEW, OVERVIEW))
    inset.imshow(np.asarray(overview.image), extent=overview.extent, interpolation="antialiased")
    x0, x1, y0, y1 = ground.extent
    inset.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="white", linewidth=3))
    inset.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=GOAL, linewidth=1.5))
    inset.set(xticks=[], yticks=[], xlim=(left, right), ylim=(bottom, top), anchor="NW")
    inset.set_title(f"overview, {right - left:.0f} × {top - bottom:.0f} m", fontsize=8)


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


def save_figure(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."), bbox_inches="tight")
