"""Colours, marks and resolution shared by all figures, and how a figure is saved."""

import itertools
from collections.abc import Iterable
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from splatrl.envs.tasks.base import Mark
from splatrl.files import replacing

REACHED, PARTLY, MISSED = "#009e73", "#e69f00", "#d55e00"  # distinguishable with any colour vision
GOAL, TEST, BLUE, PURPLE, INK = "#e0409f", "#f0e442", "#0072b2", "#8a5a99", "#222222"
MARKS = ((GOAL, 0), (TEST, 4), ("#56b4e9", 3))
"""Colour and number of corners (0 is a dot) of marks, assigned to their names in order of first appearance."""
DPI = 160
"""Resolution of saved figures, dots per inch."""


def mark_styles(marks: Iterable[Mark]) -> dict[str, tuple[str, int]]:
    """Assign a look to the marks of each name: colour and number of corners."""
    names = dict.fromkeys(mark.name for mark in marks)
    return dict(zip(names, itertools.cycle(MARKS)))


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically, in the format that the suffix of its path names."""
    FigureCanvasAgg(figure)
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."), bbox_inches="tight")
