"""The rows that render.py measures, and the renderers that they need."""

import argparse
import itertools
from typing import Literal, NamedTuple

from scenes import Subject, truncated

from splatrl.renderers import NativeRenderer

Mode = Literal["antialiased", "classic"]


class Look(NamedTuple):
    """All settings that determine an image."""

    scene: str
    sh_degree: int
    mode: Mode
    tolerance: float


class Setup(NamedTuple):
    """A row of the table: all settings that determine the time of a call."""

    look: Look
    batch: int
    threads: int


class Renderers(dict[Look, NativeRenderer]):
    """Renderers by look, each built on first use."""

    def __init__(self, subjects: dict[str, Subject]):
        self.subjects = subjects

    def __missing__(self, look: Look) -> NativeRenderer:
        scene = truncated(self.subjects[look.scene].scene, look.sh_degree)
        self[look] = NativeRenderer(scene, antialiased=look.mode == "antialiased", tolerance=look.tolerance)
        return self[look]


def planned(subjects: dict[str, Subject], options: argparse.Namespace) -> list[Setup]:
    """List the rows, exact and at each tolerance: with ``full`` every combination, else one option varied at a time."""
    axes = (options.mode, options.batch, options.threads)
    own = {name: subject.scene.gaussians.sh_degree for name, subject in subjects.items()}
    points: list[tuple[str, int, tuple[Mode, int, int]]] = []
    if options.full:
        for name, degree, point in itertools.product(subjects, options.sh, itertools.product(*axes)):
            points.append((name, min(degree, own[name]), point))
    else:
        base = tuple(values[0] for values in axes)
        first = next(iter(subjects))
        points += [(name, min(options.sh[0], own[name]), base) for name in subjects]
        for axis, values in enumerate(axes):
            for value in values[1:]:
                points.append((first, min(options.sh[0], own[first]), (*base[:axis], value, *base[axis + 1 :])))
        points += [(name, min(degree, own[name]), base) for degree in options.sh[1:] for name in subjects]
    return [
        Setup(Look(name, degree, mode, tolerance), batch, threads)
        for name, degree, (mode, batch, threads) in dict.fromkeys(points)
        for tolerance in (0.0, *options.tolerance)
    ]
