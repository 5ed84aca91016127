"""Figure of a run of capture.py: the time of each stage, the camera positions, and held-out images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from splatrl.capture.truth import closest_similarity
from splatrl.capture.world import Placed
from splatrl.evaluation.figure_style import BLUE, DPI, INK, MISSED
from splatrl.files import replacing

SHOWN = 4


@dataclass(frozen=True)
class Likeness:
    """A held-out photo and the render of the same view, each [H, W, 3] in [0, 1]."""

    photo: NDArray[np.float64]
    drawn: NDArray[np.float64]
    psnr: float
    ssim: float
    psnr_corrected: float


class Timed(Protocol):
    """A stage and its wall-clock and CPU seconds."""

    @property
    def stage(self) -> str: ...
    @property
    def wall(self) -> float: ...
    @property
    def cpu(self) -> float: ...


def draw(laps: Sequence[Timed], alike: Sequence[Likeness], placed: Placed, true: Tensor, path: Path) -> None:
    """Draw the figure.

    Args:
        laps: times of the stages; the parts of stages, which have no CPU time, are left out.
        alike: held-out images.
        placed: the capture.
        true: [N, 4, 4] true poses of its cameras.
        path: file to write; its suffix selects the format.
    """
    figure = Figure(figsize=(14, 8), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subfigures(2, 1, height_ratios=(4, 3))
    bars, plan = top.subplots(1, 2)
    stages = [lap for lap in laps if not np.isnan(lap.cpu)]
    rows = np.arange(len(stages))
    bars.barh(rows - 0.2, [lap.wall for lap in stages], 0.4, color=BLUE, label="wall")
    bars.barh(rows + 0.2, [lap.cpu for lap in stages], 0.4, color=INK, label="CPU")
    bars.set(yticks=rows, yticklabels=[lap.stage for lap in stages], xlabel="seconds")
    bars.invert_yaxis()
    bars.legend(frameon=False)
    places = placed.reconstruction.camera_to_world[:, :3, 3]
    transform = closest_similarity(places, true[:, :3, 3])
    found = (places @ transform[:3, :3].T + transform[:3, 3]).numpy()
    plan.plot(*true[:, :2, 3].T.numpy(), color="0.6", linewidth=3, label="true")
    plan.plot(*found[:, :2].T, ".", color=MISSED, markersize=4, label="found")
    plan.set(aspect="equal", xlabel="x, metres", ylabel="y, metres")
    plan.legend(frameon=False)
    order = np.argsort([one.psnr for one in alike])
    chosen = [alike[order[round(place)]] for place in np.linspace(0, len(alike) - 1, min(SHOWN, len(alike)))]
    cells = bottom.subplots(2, max(len(chosen), 1), squeeze=False)
    for column, one in enumerate(chosen):
        for row, (image, words) in enumerate(((one.photo, "photo"), (one.drawn, f"{one.psnr:.1f} dB"))):
            cells[row, column].imshow(np.clip(image, 0, 1))
            cells[row, column].set_title(words, fontsize=9)
    for cell in cells.flat:
        cell.set_axis_off()
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix[1:])
