"""Figure of a run of render.py: speed, quality, and example images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter
from torch import Tensor

from splatrl.evaluation.figure_style import BLUE, DPI, INK, MISSED, PARTLY, PURPLE, REACHED
from splatrl.files import replacing

COLORS = (INK, BLUE, REACHED, PARTLY, MISSED, PURPLE)  # exact, then each tolerance
MARKERS = "osD^vP"  # one per scene
AMPLIFIED = 8


@dataclass(frozen=True)
class Bar:
    """One row of the table as the figure shows it; fields as in ``render.Result``."""

    scene: str
    tolerance: float
    frames_per_second: float
    slowest: float
    fastest: float
    true_mean_db: float
    true_worst_db: float


@dataclass(frozen=True)
class Comparison:
    """One view, exact and with level of detail, each [H, W, 3] float32 in [0, 1]."""

    scene: str
    tolerance: float
    exact: Tensor
    coarse: Tensor
    decibels: float


def tolerance_name(tolerance: float) -> str:
    """Return the label of a tolerance."""
    return f"LOD {tolerance:g} px" if tolerance else "exact"


def draw(bars: Sequence[Bar], comparisons: Sequence[Comparison], title: str, path: Path) -> None:
    """Draw bars of speed, quality against speed, and the worst view of each scene.

    Args:
        bars: rows in the order of the table.
        comparisons: one per scene; empty without level of detail.
        title: what the rows have in common.
        path: file to write; its suffix selects the format.
    """
    rows = -(-len(comparisons) // 3)
    figure = Figure(figsize=(15, 5 + 2.4 * rows), dpi=DPI, layout="constrained")
    above, *below = figure.subfigures(1 + (rows > 0), 1, height_ratios=[5, 2.4 * rows][: 1 + (rows > 0)], squeeze=False)
    left, right = above[0].subplots(1, 2)
    above[0].suptitle(title)
    _speeds(left, bars)
    _qualities(right, bars)
    if below:
        _sheet(below[0][0].subplots(rows, 3 * min(3, len(comparisons)), squeeze=False), comparisons)
        below[0][0].suptitle(f"worst view with level of detail, and {AMPLIFIED} times its difference from exact")
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."))


def _speeds(axes: Axes, bars: Sequence[Bar]) -> None:
    scenes, tolerances = _scenes(bars), _tolerances(bars)
    most = max(bar.fastest for bar in bars)
    thickness = 0.8 / len(tolerances)
    for bar in bars:
        rank = tolerances.index(bar.tolerance)
        place = scenes.index(bar.scene) + (rank - (len(tolerances) - 1) / 2) * thickness
        spread = [[bar.frames_per_second - bar.slowest], [bar.fastest - bar.frames_per_second]]
        axes.barh(place, bar.frames_per_second, 0.92 * thickness, color=_color(tolerances, bar.tolerance))
        axes.errorbar(bar.frames_per_second, place, xerr=spread, color="0.5", capsize=2.5, linewidth=1.2)
        axes.text(bar.fastest + 0.015 * most, place, f"{bar.frames_per_second:,.0f}", va="center", fontsize=9)
    axes.set_yticks(range(len(scenes)), scenes)
    axes.invert_yaxis()
    axes.set(xlabel="frames/s, median and spread of the rounds", xlim=(0, 1.15 * most))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.grid(axis="x", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    handles = [axes.barh(0, 0, color=_color(tolerances, t), label=tolerance_name(t)) for t in tolerances]
    axes.legend(handles=handles, frameon=False, ncols=len(tolerances), loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _qualities(axes: Axes, bars: Sequence[Bar]) -> None:
    scenes, tolerances = _scenes(bars), _tolerances(bars)
    for scene, marker in zip(scenes, MARKERS, strict=False):
        mine = [bar for bar in bars if bar.scene == scene]
        axes.plot(
            [bar.frames_per_second for bar in mine], [bar.true_mean_db for bar in mine], color="0.75", linewidth=1
        )
        for bar in mine:
            color = _color(tolerances, bar.tolerance)
            speeds = [bar.frames_per_second, bar.frames_per_second]
            axes.plot(speeds, [bar.true_worst_db, bar.true_mean_db], ":", color=color, linewidth=1)
            axes.plot(speeds[0], bar.true_mean_db, marker, color=color, markersize=7)
            axes.plot(speeds[0], bar.true_worst_db, marker, color=color, markersize=5, markerfacecolor="white")
        axes.plot([], [], marker, color="0.4", linewidth=0, label=scene)
    axes.plot([], [], "o", color="0.4", markerfacecolor="white", linewidth=0, markersize=5, label="worst view")
    axes.set(xlabel="frames/s, colours as on the left", ylabel="PSNR against 8× supersampled (dB)")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.grid(color="0.9", linewidth=0.8, which="both")
    axes.set_axisbelow(True)
    axes.margins(0.08)
    axes.set_xlim(left=0)
    axes.legend(frameon=False, ncols=len(scenes) + 1, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _sheet(axes: Sequence[Sequence[Axes]], comparisons: Sequence[Comparison]) -> None:
    flat = [one for row in axes for one in row]
    for one in flat:
        one.axis("off")
    for number, item in enumerate(comparisons):
        difference = (AMPLIFIED * (item.coarse - item.exact).abs()).clamp(0, 1)
        names = (f"{item.scene}, exact", tolerance_name(item.tolerance), f"difference × {AMPLIFIED}")
        names = (names[0], f"{names[1]}: {item.decibels:.1f} dB", names[2])
        for one, image, name in zip(flat[3 * number :], (item.exact, item.coarse, difference), names, strict=False):
            one.imshow(image.numpy(), interpolation="nearest")
            one.set_title(name, fontsize=9)


def _scenes(bars: Sequence[Bar]) -> list[str]:
    return list(dict.fromkeys(bar.scene for bar in bars))


def _tolerances(bars: Sequence[Bar]) -> list[float]:
    return sorted({bar.tolerance for bar in bars})


def _color(tolerances: Sequence[float], tolerance: float) -> str:
    return COLORS[tolerances.index(tolerance) % len(COLORS)]
