"""Report of an experiment from its finished runs: ``report.md``, ``report.json`` and figures."""

import itertools
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from splatrl.documents import write_json
from splatrl.evaluation.pictures import START_MAP, SUCCESS_MAP
from splatrl.experiments.curves import learning_curves
from splatrl.experiments.experiment import Experiment
from splatrl.experiments.results import Entry, Spread, comparable, entries
from splatrl.experiments.tables import (
    main_table,
    marks_table,
    scores_sentences,
    scores_table,
    table,
    transfer_sentences,
    transfer_table,
    verdicts,
)
from splatrl.files import replacing

SCORES, MACHINE, FIGURES, VIEWS = "scores.json", "machine.json", "capture.json", "views.png"
MAPS = {START_MAP: "start poses by success", SUCCESS_MAP: "success by start position"}
"""Pictures of a run that are shown side by side, with their captions."""
LETTERS = 40
"""Number of letters of a scene's name in the name of a file; a letter may take four of 255 bytes."""
EXPLANATION = (
    "Success is measured over the start set (if it has more than `evaluation.starts` poses, over that many, evenly "
    "spaced) with actions sampled from the policy; argmax takes the most likely action instead. "
    "SPL weights success by the length of the shortest path relative to that of the path taken. "
    "Values are means over seeds ± their standard deviation. "
    "An arm has won if its success differs from that of the next best one at p < 0.05 (Welch's t-test over the seeds)."
)


@dataclass(frozen=True)
class Curve:
    """A figure with the learning curves of one comparison.

    Attributes:
        title: scene and number of frames of the comparison.
        path: file of the figure.
    """

    title: str
    path: Path


def write_report(experiment: Experiment, machine: str) -> Path:
    """Write the report of one experiment into its folder.

    Args:
        experiment: the experiment to report.
        machine: description of the machine, used if none was recorded when the experiment ran; empty if not known.

    Returns:
        Path of ``report.md``.
    """
    experiment.folder.mkdir(parents=True, exist_ok=True)
    found = entries(experiment)
    write_json(experiment.folder / "report.json", _numbers(experiment, found, machine))  # first: it names the folder
    curves = _draw(found, experiment.folder)
    path = experiment.folder / "report.md"
    _write(path, [*_section(experiment, found, curves, experiment.folder, "#", machine), ""])
    return path


def write_joint_report(experiments: Sequence[Experiment], folder: Path, machine: str) -> Path:
    """Write a joint report of several experiments, whose own reports and figures exist already.

    Args:
        experiments: the experiments to report.
        folder: parent folder of all experiments.
        machine: as in ``write_report``.

    Returns:
        Path of ``report.md``.
    """
    lines = ["# Experiments", "", EXPLANATION, ""]
    for experiment in experiments:
        found = entries(experiment)
        lines += [*_section(experiment, found, _curves(found, experiment.folder), folder, "##", machine), ""]
    path = folder / "report.md"
    _write(path, lines)
    return path


def _section(
    experiment: Experiment, found: Sequence[Entry], curves: Sequence[Curve], base: Path, heading: str, machine: str
) -> list[str]:
    finished = sum(len(entry.runs) for entry in found)
    lines = [f"{heading} {experiment.title}", ""]
    if experiment.question is not None:
        lines += [f"**Question.** {experiment.question}", ""]
    if experiment.paper is not None:
        lines += [f"**Paper.** {experiment.paper}", ""]
    if not finished:
        return [*lines, f"**Results.** None of {len(experiment.runs)} trainings is finished."]
    every = _scores(experiment)
    tests = [row for row in every if "place" in row]
    scores = [row for row in every if "clip" in row]
    sentences = [*scores_sentences(scores, experiment), *transfer_sentences(tests, experiment)]
    lines += ["**Results.**", "", *sentences, *verdicts(found), ""]
    if finished < len(experiment.runs):
        lines += [f"*{finished} of {len(experiment.runs)} trainings are finished; the others are left out.*", ""]
    lines += [line for each in experiment.left_out for line in (f"*{each}*", "")]
    lines += [*main_table(found), ""]
    if heading == "#":
        lines += [EXPLANATION, ""]
    if scores:
        lines += [f"{heading}# Actions on labelled clips", "", *scores_table(scores, experiment), ""]
    if tests:
        lines += [f"{heading}# Tests in each scene", "", *transfer_table(tests, experiment), ""]
    lines += _capture(experiment, base, heading)
    lines += [f"{heading}# Success during training", "", *marks_table(found, experiment), ""]
    lines += ["Tests are episodes from starts spread over the whole start set, whatever the curriculum's level.", ""]
    for curve in curves:
        lines += [
            f"![{curve.title}]({_link(curve.path, base)})",
            "",
            f"*{curve.title}: mean and range over the seeds.*",
            "",
        ]
    lines += [f"{heading}# Policies of the median seed", ""]
    for entry in found:
        lines += _pictures(entry, base)
    known = _machine(experiment, machine)
    return [*lines, f"Run on: {known}."] if known else lines


def _capture(experiment: Experiment, base: Path, heading: str) -> list[str]:
    """Write the section on the scene captured for the experiment: figures and views; empty if there is none."""
    path, views = experiment.folder / FIGURES, experiment.folder / VIEWS
    if not path.exists():
        return []
    figures = json.loads(path.read_text())["figures"]
    rows = [[name.replace("_", " "), "–" if value is None else f"{value:.4g}"] for name, value in figures.items()]
    lines = [f"{heading}# The captured scene", "", *table(["figure", "value"], rows, words=1), ""]
    if views.exists():
        lines += [
            f"![What robots see]({_link(views, base)})",
            "",
            "*Top: in the original; bottom: in the capture.*",
            "",
        ]
    return lines


def _pictures(entry: Entry, base: Path) -> list[str]:
    """Link the pictures of the median seed that exist."""
    if not entry.runs:
        return []
    run = entry.median()
    rate = Spread((entry.evaluations[list(entry.runs).index(run)]["success_rate"],)).percent()
    lines = [f"**{entry.scene}, {entry.label}**, seed {run.seed}, success {rate}", ""]
    maps = [name for name in MAPS if (run.folder / name).exists()]
    if maps:
        pictures = [f"![{MAPS[name]}]({_link(run.folder / name, base)})" for name in maps]
        lines += [*table([MAPS[name] for name in maps], [pictures], words=len(maps)), ""]
    more = {
        "scenes.png": "success in each scene",
        "learning_curve.png": "learning curve",
        "rollouts.mp4": "video of rollouts",
    }
    links = [f"[{more[name]}]({_link(run.folder / name, base)})" for name in more if (run.folder / name).exists()]
    return [*lines, " · ".join(links), ""] if links else lines


def _curves(found: Sequence[Entry], folder: Path) -> list[Curve]:
    """Return the figure of each comparison; file names are short enough for every file system, and all differ."""
    curves = dict[Path, Curve]()
    for group in comparable(found):
        scene, budget = group[0].scene, group[0].budget
        place = re.sub(r"[^\w.=-]+", "-", scene)[:LETTERS]
        path, others = folder / f"curves-{place}-{budget}.png", itertools.count(2)
        while path in curves:
            path = folder / f"curves-{place}-{budget}-{next(others)}.png"
        curves[path] = Curve(f"{scene}, {budget:,} frames", path)
    return list(curves.values())


def _draw(found: Sequence[Entry], folder: Path) -> list[Curve]:
    curves = _curves(found, folder)
    for curve, group in zip(curves, comparable(found), strict=True):
        learning_curves(group, curve.path)
    return curves


def _numbers(experiment: Experiment, found: Sequence[Entry], machine: str) -> dict[str, Any]:
    keys = ("success_rate", "success_rate_argmax", "step_spl", "spl", "level", "frames", "wall_seconds")
    arms = [
        {
            "scene": entry.scene,
            "arm": entry.label,
            "budget": entry.budget,
            "seeds": [run.seed for run in entry.runs],
            **{key: _values(entry.spread(key)) for key in keys},
            "frames_per_second": _values(entry.speed()),
            "tested_at": {str(mark): _values(entry.tested_at(mark)) for mark in experiment.marks},
            f"frames_to_{experiment.threshold}": _values(entry.frames_to(experiment.threshold)),
            f"minutes_to_{experiment.threshold}": _values(entry.minutes_to(experiment.threshold)),
        }
        for entry in found
    ]
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "machine": _machine(experiment, machine),
        "trainings": len(experiment.runs),
        "arms": arms,
        "scores": _scores(experiment),
    }


def _values(spread: Spread) -> dict[str, Any]:
    several = len(spread.values) > 1
    return {
        "mean": spread.mean if spread.values else None,
        "deviation": spread.deviation if several else None,
        "values": list(spread.values),
    }


def _scores(experiment: Experiment) -> list[Mapping[str, Any]]:
    path = experiment.folder / SCORES
    return list(json.loads(path.read_text())["scores"]) if path.exists() else []


def _machine(experiment: Experiment, otherwise: str) -> str:
    path = experiment.folder / MACHINE
    return str(json.loads(path.read_text())["machine"]) if path.exists() else otherwise


def _link(path: Path, base: Path) -> str:
    return quote(Path(os.path.relpath(path, base)).as_posix())


def _write(path: Path, lines: Sequence[str]) -> None:
    with replacing(path) as stream:
        stream.write("\n".join(lines).rstrip("\n").encode() + b"\n")
