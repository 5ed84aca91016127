"""Learning curves of the arms of a comparison, aggregated over their seeds."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from splatrl.evaluation.figure_style import BLUE, DPI, GOAL, MISSED, PARTLY, REACHED, legible, save_figure
from splatrl.evaluation.training_figures import column
from splatrl.experiments.results import Entry

COLORS = (BLUE, MISSED, REACHED, PARTLY, GOAL)
MARKERS, DASHES = "osD^v", ("-", "--", ":")
"""Markers used besides colours, so that overlapping curves can be told apart; and the lines of each five curves."""

ROW = 0.2
"""Height of a row of the legend, inches."""
LETTERS, HANDLE = 90, 8
"""Number of letters in a row of the legend, and how many of them the line before a label takes."""


def learning_curves(group: Sequence[Entry], path: Path) -> None:
    """Plot test success, training success and curriculum level against frames: mean and range over the seeds.

    Args:
        group: arms with finished runs.
        path: file of the figure; its suffix sets the format.
    """
    staged = [entry.has_curriculum for entry in group]
    rows = 3 if any(staged) else 2
    figure = Figure(figsize=(7.2, 2.2 * rows), dpi=DPI, layout="constrained")
    panels: list[Axes] = list(figure.subplots(rows, 1, sharex=True, height_ratios=(3, 3, 2)[:rows]))
    handles = []
    for number, entry in enumerate(group):
        marker, style = look(number)
        _band(panels[0], entry, "test_success", style, marker)
        _band(panels[1], entry, "success", style)
        if staged[number]:
            _band(panels[2], entry, "level", style)
        seeds = f"{len(entry.runs)} seed{'s' if len(entry.runs) > 1 else ''}"
        label = f"{legible(entry.label)} ({seeds})"
        handles.append(Line2D([], [], marker=marker, markersize=4.5, linewidth=2, label=label, **style))
    for panel, label in zip(panels, ("test success", "training success"), strict=False):
        panel.set(ylabel=label, ylim=(-0.02, 1.02))
        panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    if any(staged):
        panels[2].set(ylabel="curriculum level")
        panels[2].set_ylim(bottom=0)
        panels[2].yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
    for panel in panels:
        panel.grid(color="0.9", linewidth=0.8)
        panel.set_axisbelow(True)
        panel.margins(x=0.01)
    panels[-1].set(xlabel="frames")
    panels[-1].set_xlim(left=0)
    panels[-1].xaxis.set_major_formatter(EngFormatter(sep=""))
    figure.align_ylabels(panels)
    columns = max(1, min(len(handles), 3, LETTERS // (HANDLE + max(len(str(line.get_label())) for line in handles))))
    figure.set_figheight(2.2 * rows + 0.4 + ROW * math.ceil(len(handles) / columns))  # else many arms leave no panels
    legend = figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False, handlelength=3.5)
    for words in legend.get_texts():
        words.set_parse_math(False)
    save_figure(figure, path)


def look(number: int) -> tuple[str, dict[str, Any]]:
    """Return the marker and the style of a curve's line, which no other of the first fifteen curves has."""
    turn, place = divmod(number, len(COLORS))
    return MARKERS[place], {"color": COLORS[place], "linestyle": DASHES[turn % len(DASHES)]}


def _band(axes: Axes, entry: Entry, key: str, style: Mapping[str, Any], marker: str = "") -> None:
    """Plot the mean over the seeds as a line, and their range as a band."""
    histories = [rows for rows in entry.histories if rows]
    if not histories:
        return
    length = min(map(len, histories))
    frames = column(histories[0][:length], "frames")
    seeds = np.stack([_values(rows[:length], key) for rows in histories])
    known = ~np.isnan(seeds).any(0)
    if not known.any():  # an empty band would leave the layout no room
        return
    frames, seeds = frames[known], seeds[:, known]
    axes.fill_between(frames, seeds.min(0), seeds.max(0), color=style["color"], alpha=0.18, linewidth=0)
    axes.plot(frames, seeds.mean(0), marker=marker, markersize=4.5, linewidth=2, clip_on=not marker, **style)


def _values(rows: Sequence[dict[str, float]], key: str) -> NDArray[np.float64]:
    """Return a column as plotted: training success is a running mean over 1/12 of the rows.

    Each row of the running mean is weighted by its number of episodes.
    """
    values = column(rows, key)
    if key != "success":
        return values
    weights = np.where(np.isnan(values), 0.0, np.nan_to_num(column(rows, "episodes"), nan=1.0))
    window = np.ones(math.ceil(len(values) / 12))
    sums, counts = (np.convolve(part, window)[: len(values)] for part in (weights * np.nan_to_num(values), weights))
    return np.divide(sums, counts, out=np.full(len(values), math.nan), where=counts > 0)
