"""What the seeds of an arm add up to."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from splatrl.experiments.experiment import Experiment, Run
from splatrl.experiments.folders import evaluation, history, status


@dataclass(frozen=True)
class Spread:
    """Values of several seeds.

    Attributes:
        values: one a seed.
    """

    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Over seeds."""
        return statistics.fmean(self.values)

    @property
    def deviation(self) -> float:
        """Standard deviation of a sample; NaN for a single seed."""
        return statistics.stdev(self.values) if len(self.values) > 1 else math.nan

    def text(self, digits: int = 0, factor: float = 1.0) -> str:
        """Mean ± standard deviation, times a factor."""
        if not self.values:
            return "–"
        mean = f"{factor * self.mean:,.{digits}f}"
        return mean if len(self.values) == 1 else f"{mean} ± {factor * self.deviation:,.{digits}f}"

    def percent(self) -> str:
        """The same in percent."""
        return f"{self.text(1, 100.0)} %" if self.values else "–"


@dataclass(frozen=True, eq=False)
class Entry:
    """An arm in one scene: its finished runs.

    Attributes:
        label: of the arm.
        scene: name of the scene.
        budget: frames that each run was given.
        runs: finished ones.
    """

    label: str
    scene: str
    budget: int
    runs: Sequence[Run]

    @cached_property
    def evaluations(self) -> list[dict[str, Any]]:
        """``evaluation.json`` of each run."""
        return [evaluation(run) for run in self.runs]

    @cached_property
    def histories(self) -> list[list[dict[str, float]]]:
        """``progress.csv`` of each run."""
        return [history(run) for run in self.runs]

    @property
    def has_curriculum(self) -> bool:
        """Whether its runs begin with a part of the start set."""
        return any(run.has_curriculum for run in self.runs)

    def spread(self, key: str) -> Spread:
        """A value of ``evaluation.json`` over the seeds."""
        return Spread(tuple(float(values[key]) for values in self.evaluations if key in values))

    def speed(self) -> Spread:
        """Frames a second of training."""
        return Spread(
            tuple(values["frames"] / values["wall_seconds"] for values in self.evaluations if values["wall_seconds"])
        )

    def tested_at(self, frames: int) -> Spread:
        """Success in the test that was taken at a number of frames, within one batch."""
        return Spread(tuple(value for rows in self.histories if (value := success_near(rows, frames)) is not None))

    def frames_to(self, success: float) -> Spread:
        """Frames of the first test with a success of at least this, of the seeds that got there."""
        first = (
            next((at for at, value in success_in_tests(rows) if value >= success), None) for rows in self.histories
        )
        return Spread(tuple(float(at) for at in first if at is not None))

    def median(self) -> Run:
        """The run whose success is the median, the lower of two."""
        order = sorted(range(len(self.runs)), key=lambda number: self.evaluations[number]["success_rate"])
        return self.runs[order[(len(order) - 1) // 2]]


def entries(experiment: Experiment) -> list[Entry]:
    """Every arm in every scene of an experiment, scene by scene, with its finished runs."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in experiment.runs:
        groups.setdefault((run.scene, run.arm), []).append(run)
    scenes = list(dict.fromkeys(run.scene for run in experiment.runs))
    ordered = sorted(groups.items(), key=lambda group: scenes.index(group[0][0]))
    return [
        Entry(runs[0].label, scene, runs[0].budget, [run for run in runs if status(run) == "finished"])
        for (scene, _), runs in ordered
    ]


def comparable(found: Iterable[Entry]) -> list[list[Entry]]:
    """Entries with finished runs, those of the same scene and number of frames together."""
    groups: dict[tuple[str, int], list[Entry]] = {}
    for entry in found:
        if entry.runs:
            groups.setdefault((entry.scene, entry.budget), []).append(entry)
    return list(groups.values())


def success_in_tests(rows: Sequence[Mapping[str, float]]) -> list[tuple[int, float]]:
    """Frames and success of each test of a training."""
    return [
        (int(row["frames"]), row["test_success"]) for row in rows if not math.isnan(row.get("test_success", math.nan))
    ]


def success_near(rows: Sequence[Mapping[str, float]], frames: int) -> float | None:
    """Success in the test nearest to a number of frames, None where none is within one batch of it."""
    taken = success_in_tests(rows)
    if not taken:
        return None
    at, success = min(taken, key=lambda test: abs(test[0] - frames))
    return success if abs(at - frames) < rows[0]["frames"] else None
