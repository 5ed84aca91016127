"""Figures of a training: its learning curve, and its success in each of several scenes."""

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

from splatrl.evaluation.figure_style import BLUE, DPI, INK, PURPLE, TEST, legible, save_figure


def learning_curve(history: Sequence[Mapping[str, float]], path: Path) -> None:
    """Plot success, curriculum level and return over the frames of a training, those that have values.

    Args:
        history: one row per iteration with ``frames`` and any of ``success``, ``test_success``, ``level``,
            ``return`` and ``episodes``; missing values and NaN leave a gap.
        path: file of the figure; its suffix sets the format.
    """
    frames, episodes = column(history, "frames"), np.nan_to_num(column(history, "episodes"), nan=1.0)
    names = ("success", "test_success", "level", "return")
    known = {name: values for name in names if not np.isnan(values := column(history, name)).all()}
    rows = 2 if "return" in known else 1
    figure = Figure(figsize=(7.2, 5.4 if rows == 2 else 3.6), dpi=DPI, layout="constrained")
    above, *rest = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=(3, 2)[:rows])[:, 0]
    handles = []
    if "success" in known:
        _curve(above, frames, known["success"], episodes, BLUE)
        handles += [Line2D([], [], color=BLUE, linewidth=2, label="training episodes")]
    if "test_success" in known:
        style: dict[str, Any] = {"color": INK, "marker": "D", "markersize": 4.5, "linewidth": 0}
        style |= {"markerfacecolor": TEST}
        above.plot(frames, known["test_success"], clip_on=False, **style)
        handles += [Line2D([], [], label="test", **style)]
    if handles:
        above.set(ylabel="success", ylim=(-0.02, 1.02))
        above.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    else:
        above.set_yticks([])
        above.text(0.5, 0.5, "no episode has ended yet", transform=above.transAxes, ha="center", va="center", color=INK)
    if "level" in known:
        _levels(above, frames, known["level"])
        handles += [Line2D([], [], color=PURPLE, linewidth=1.2, label="curriculum level")]
    if handles:
        figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False)
    for below in rest:
        _curve(below, frames, known["return"], episodes, BLUE)
        below.set_ylabel("episode return")
        below.ticklabel_format(axis="y", useOffset=False, style="plain")
    for axes in (above, *rest):
        axes.grid(color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.margins(x=0.01)
    lowest = [above, *rest][-1]
    lowest.set_xlabel("frames")
    lowest.xaxis.set_major_formatter(EngFormatter(sep=""))
    lowest.set_xlim(left=0)
    save_figure(figure, path)


def _levels(axes: Axes, frames: NDArray[np.float64], level: NDArray[np.float64]) -> None:
    """Plot the curriculum's levels [rows] behind a panel and on a scale of their own."""
    behind = axes.twinx()
    begun, held = np.append(0.0, frames), np.append(level[:1], level)  # a row's level applies to the frames before it
    behind.fill_between(begun, 0, held, step="pre", color=PURPLE, alpha=0.12, linewidth=0)
    behind.step(begun, held, where="pre", color=PURPLE, linewidth=1.2)
    behind.set_ylim(0, max([1.0, *level[~np.isnan(level)]]) * 1.05)
    behind.yaxis.set_major_locator(MaxNLocator(integer=True))
    behind.set_ylabel("curriculum level", color=PURPLE)
    behind.tick_params(axis="y", colors=PURPLE)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)


def scene_bars(
    names: Sequence[str], success: Sequence[float], intervals: Sequence[Sequence[float]], path: Path
) -> None:
    """Plot the success rate in each of several scenes as bars with 95 % confidence intervals, the best scene first.

    Args:
        names: names of the scenes.
        success: success rates in [0, 1], one per scene.
        intervals: lowest and highest rate that agree with the episodes, [S, 2].
        path: file of the figure; its suffix sets the format.
    """
    order = np.argsort(-np.asarray(success), kind="stable")
    figure = Figure(figsize=(7.2, 0.9 + 0.19 * len(names)), dpi=DPI, layout="constrained")
    axes, rates = figure.subplots(), np.asarray(success)[order]
    low, high = np.asarray(intervals, dtype=np.float64)[order].T
    reach = np.clip([rates - low, high - rates], 0.0, None)  # rounding may put a rate of 0 or 1 just outside
    axes.barh(np.arange(len(names)), rates, 0.72, color=BLUE)
    axes.errorbar(rates, np.arange(len(names)), xerr=reach, fmt="none", ecolor=INK, elinewidth=1, capsize=2)
    for row, rate in enumerate(rates):
        label = axes.text(high[row] + 0.008, row, f"{rate:.0%}", va="center", fontsize=8, color=INK)
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1})  # covers the line of the average
    axes.axvline(float(np.mean(rates)), color=INK, linewidth=1, linestyle="--", zorder=0)
    over = f"{len(names)} scenes, {np.mean(rates):.1%} on average" if len(names) > 1 else "1 scene"
    axes.set_title(f"success rate in {over}", fontsize=11)
    axes.set_yticks(np.arange(len(names)), [legible(names[i]) for i in order], fontsize=8, parse_math=False)
    axes.set(xlim=(0, 1.08), ylim=(len(names) - 0.4, -0.6), xlabel="success, with 95 % confidence intervals")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    save_figure(figure, path)


def column(history: Sequence[Mapping[str, float]], key: str) -> NDArray[np.float64]:
    """Return one value of each row of a history, NaN where a row lacks it: [R] float64."""
    return np.array([row.get(key, math.nan) for row in history], dtype=np.float64)


def _curve(
    axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64], color: str
) -> None:
    """Plot raw values faintly, and their weighted running mean over 1/12 of the rows; few rows are marked by dots.

    ``x``, ``y`` and ``weights`` are [R] each; rows in which ``y`` is NaN are left out.
    """
    known = ~np.isnan(y)
    x, y, weights = x[known], y[known], weights[known]
    axes.plot(x, y, ".-", color=color, linewidth=0.8, markersize=4, alpha=0.35)
    rows = math.ceil(len(y) / 12)
    sums = [np.convolve(values, np.ones(rows))[: len(y)] for values in (weights * y, weights)] if len(y) else [y, y]
    axes.plot(x, sums[0] / sums[1], color=color, linewidth=2, marker="o" if rows == 1 else "", markersize=5)
