"""Figure of a run of gpu.py."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from figure import COLORS, MARKERS, tolerance_name
from gpu_bench import Bench
from gpu_collision import Collision
from gpu_reach import MEAN_DB, WORST_DB, Target
from gpu_render import Likeness, Rendering
from gpu_tables import number
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from splatrl.evaluation.figure_style import BLUE, DPI, INK, MISSED, PURPLE, REACHED
from splatrl.files import replacing

BODY_COLORS = {"box": INK, "sphere": BLUE, "capsule": PURPLE}


def draw(bench: Bench, targets: Sequence[Target], title: str, path: Path) -> None:
    """Draw speed by batch size, quality by speed, collision queries, and the results relative to the targets.

    Args:
        bench: holds the results; there is no panel for what was not measured.
        targets: the targets of ``gpu_reach``.
        title: what was measured.
        path: file to write, unless nothing was measured; its suffix selects the format.
    """
    measured = [target for target in targets if not math.isnan(target.found)]
    panels: list[tuple[bool, Callable[[Axes], None]]] = [
        (bool(bench.found(Rendering)), lambda axes: _speeds(axes, bench.found(Rendering))),
        (bool(bench.found(Likeness, against="exact")), lambda axes: _qualities(axes, bench)),
        (bool(bench.found(Collision)), lambda axes: _queries(axes, bench.found(Collision))),
        (bool(measured), lambda axes: _reach(axes, measured)),
    ]
    drawn = [panel for any_results, panel in panels if any_results]
    if not drawn:
        return
    down, across = math.ceil(len(drawn) / 2), min(2, len(drawn))
    figure = Figure(figsize=(7.5 * across, 5 * down), dpi=DPI, layout="constrained")
    figure.suptitle(title)
    for place, panel in enumerate(drawn):
        panel(figure.add_subplot(down, across, place + 1))
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."))


def _speeds(axes: Axes, rows: Sequence[Rendering]) -> None:
    tolerances = sorted({row.tolerance for row in rows})
    for scene, marker in zip(_scenes(rows), MARKERS, strict=False):
        for rank, tolerance in enumerate(tolerances):
            mine = [r for r in rows if (r.renderer, r.scene, r.tolerance) == ("CudaRenderer", scene, tolerance)]
            mine.sort(key=lambda row: row.batch)
            rates = [row.frames_per_second.typical for row in mine]
            label = f"{scene}, {tolerance_name(tolerance)}"
            axes.plot([row.batch for row in mine], rates, marker=marker, color=COLORS[rank], label=label)
        for row in (r for r in rows if (r.renderer, r.scene) == ("gsplat", scene)):
            axes.plot(row.batch, row.frames_per_second.typical, marker, color=MISSED, label=f"{scene}, gsplat exact")
    batches = sorted({row.batch for row in rows})
    axes.set(xscale="log", yscale="log", xlabel="cameras per launch", ylabel="frames/s", title="Rendering")
    axes.set_xticks(batches, [f"{batch:,}" for batch in batches], minor=False)
    axes.xaxis.set_minor_locator(NullLocator())
    _plain(axes.yaxis)
    _finish(axes, beside=True)


def _qualities(axes: Axes, bench: Bench) -> None:
    rows = bench.found(Likeness, against="exact")
    tolerances = sorted({0.0, *(row.tolerance for row in rows)})
    for scene, marker in zip(_scenes(rows), MARKERS, strict=False):
        for row in (one for one in rows if one.scene == scene):
            speeds = bench.found(Rendering, renderer="CudaRenderer", scene=scene, tolerance=row.tolerance)
            if not speeds:
                continue
            best, color = max(s.frames_per_second.typical for s in speeds), COLORS[tolerances.index(row.tolerance)]
            axes.plot([best, best], [row.worst_db, row.mean_db], ":", color=color, linewidth=1)
            axes.plot(best, row.mean_db, marker, color=color, label=f"{scene}, {tolerance_name(row.tolerance)}")
            axes.plot(best, row.worst_db, marker, color=color, markerfacecolor="white", markersize=5)
    axes.plot([], [], "o", color="0.4", markerfacecolor="white", markersize=5, label="worst view")
    axes.axhline(MEAN_DB, color="0.6", linewidth=1, label="required mean")
    axes.axhline(WORST_DB, color="0.6", linewidth=1, linestyle="--", label="required worst view")
    axes.set(xscale="log", xlabel="frames/s at the best batch", ylabel="PSNR to exact (dB)", title="Level of detail")
    _plain(axes.xaxis)
    _finish(axes, beside=True)


def _queries(axes: Axes, rows: Sequence[Collision]) -> None:
    most = max(row.batch for row in rows)
    mine = [row for row in rows if row.batch == most]
    names = list(dict.fromkeys((row.query, row.voxels, row.poses) for row in mine))
    for row in mine:
        rank = list(BODY_COLORS).index(row.body) - (len(BODY_COLORS) - 1) / 2
        place = names.index((row.query, row.voxels, row.poses)) + 0.27 * rank
        axes.barh(place, row.queries_per_second.typical / 1e6, 0.25, color=BODY_COLORS[row.body])
    axes.set_yticks(range(len(names)), [f"{query}, {voxels} voxels, {poses}" for query, voxels, poses in names])
    axes.invert_yaxis()
    axes.set(xlabel=f"million queries/s, {most:,} per call", title="Collision")
    for body, color in BODY_COLORS.items():
        axes.barh(0, 0, color=color, label=body)
    _finish(axes)


def _reach(axes: Axes, targets: Sequence[Target]) -> None:
    for place, target in enumerate(targets):
        axes.barh(place, target.score, 0.6, color=REACHED if target.score >= 1 else MISSED)
        aim = target.least / target.aim if target.unit == "s" else target.aim / target.least
        axes.plot([aim, aim], [place - 0.4, place + 0.4], color=INK, linewidth=2)
        found = number(target.found, target.unit)
        axes.text(1.01, place, found, transform=axes.get_yaxis_transform(), va="center", fontsize=9)
    axes.axvline(1, color="0.5", linewidth=1)
    axes.set_yticks(range(len(targets)), [target.name.replace(", ", ",\n", 1) for target in targets], fontsize=9)
    axes.set_ylim(len(targets) - 0.5, -0.5)
    axes.set(xscale="log", xlabel="multiple of the required minimum; marks show the aims", title="Targets")
    scores = [1.0, *(target.score for target in targets)]
    axes.set_xlim(0.7 * min(scores), 1.5 * max(6.0, *scores))
    _plain(axes.xaxis, "{x:g}")
    _finish(axes, legend=False)


def _scenes(rows: Sequence[Rendering] | Sequence[Likeness]) -> list[str]:
    return list(dict.fromkeys(row.scene for row in rows))


def _plain(axis: Axis, form: str = "{x:,.0f}") -> None:
    """Write the numbers along a logarithmic axis in full."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter(form))
    axis.set_minor_locator(NullLocator())


def _finish(axes: Axes, legend: bool = True, beside: bool = False) -> None:
    axes.grid(color="0.9", linewidth=0.8, which="major")
    axes.set_axisbelow(True)
    if legend:
        place = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)} if beside else {}
        axes.legend(frameon=False, fontsize=9, **place)
