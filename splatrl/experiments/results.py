"""Results of an arm, aggregated over its seeds."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from splatrl.experiments.experiment import Experiment, Run
from splatrl.experiments.folders import evaluation, finished, history

NOTHING = "–"
"""Shown in place of values that there are none of."""


@dataclass(frozen=True)
class Spread:
    """One value per seed, with mean and deviation.

    Attributes:
        values: the values, one per seed.
    """

    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Mean over seeds."""
        return statistics.fmean(self.values)

    @property
    def deviation(self) -> float:
        """Sample standard deviation over seeds; NaN for a single seed."""
        return statistics.stdev(self.values) if len(self.values) > 1 else math.nan

    def text(self, digits: int = 0, factor: float = 1.0) -> str:
        """Format mean ± standard deviation, multiplied by a factor."""
        if not self.values:
            return NOTHING
        mean = f"{factor * self.mean:,.{digits}f}"
        return mean if len(self.values) == 1 else f"{mean} ± {factor * self.deviation:,.{digits}f}"

    def percent(self) -> str:
        """Format mean ± standard deviation in percent."""
        return f"{self.text(1, 100.0)} %" if self.values else NOTHING


@dataclass(frozen=True, eq=False)
class Entry:
    """The finished runs of an arm in one scene.

    Attributes:
        label: label of the arm.
        scene: name of the scene.
        budget: frames allotted to each run.
        runs: the finished runs.
    """

    label: str
    scene: str
    budget: int
    runs: Sequence[Run]

    @cached_property
    def evaluations(self) -> list[dict[str, Any]]:
        """``evaluation.json`` of each run."""
        return [evaluation(run.folder) for run in self.runs]

    @cached_property
    def histories(self) -> list[list[dict[str, float]]]:
        """``progress.csv`` of each run."""
        return [history(run.folder) for run in self.runs]

    @property
    def has_curriculum(self) -> bool:
        """Whether any of its runs begins with only a part of the start set."""
        return any(run.has_curriculum for run in self.runs)

    def seeds(self) -> str:
        """Name the seeds of the runs, such as 0–2, 5; a dash if there are none."""
        numbers = sorted(run.seed for run in self.runs)
        firsts = [number for number in numbers if number - 1 not in numbers]
        lasts = [number for number in numbers if number + 1 not in numbers]
        spans = zip(firsts, lasts, strict=True)
        return ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in spans) or NOTHING

    def spread(self, key: str) -> Spread:
        """Return a value of ``evaluation.json`` for each seed that has it; null is none."""
        return Spread(tuple(float(values[key]) for values in self.evaluations if values.get(key) is not None))

    def spl(self) -> Spread:
        """Return SPL by distance if the task measures it, otherwise by steps."""
        by_distance = self.spread("spl")
        return by_distance if by_distance.values else self.spread("step_spl")

    def speed(self) -> Spread:
        """Return the training speed, frames per second."""
        return Spread(
            tuple(values["frames"] / values["wall_seconds"] for values in self.evaluations if values["wall_seconds"])
        )

    def tested_at(self, frames: int) -> Spread:
        """Return the test success at a number of frames, to within one batch."""
        return Spread(tuple(value for rows in self.histories if (value := success_near(rows, frames)) is not None))

    def frames_to(self, success: float) -> Spread:
        """Return the frames until the first test with at least this success, for the seeds that reached it."""
        return self._at_first(success, "frames")

    def minutes_to(self, success: float) -> Spread:
        """Return the minutes of training, tests included, until the test that ``frames_to`` finds."""
        return Spread(tuple(seconds / 60 for seconds in self._at_first(success, "seconds").values))

    def _at_first(self, success: float, key: str) -> Spread:
        """Return a column at the first test with at least this success, for the seeds that reached it."""
        rows = (
            next((row for row in history if row.get("test_success", 0.0) >= success), {}) for history in self.histories
        )
        return Spread(tuple(row[key] for row in rows if key in row))

    def median(self) -> Run:
        """Return the run with the median success; of two in the middle, the one with the lower success."""
        order = sorted(range(len(self.runs)), key=lambda number: self.evaluations[number]["success_rate"])
        return self.runs[order[(len(order) - 1) // 2]]


def entries(experiment: Experiment) -> list[Entry]:
    """Collect the finished runs of every arm in every scene of an experiment, ordered by scene."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in experiment.runs:
        groups.setdefault((run.scene, run.arm), []).append(run)
    scenes = list(dict.fromkeys(run.scene for run in experiment.runs))
    ordered = sorted(groups.items(), key=lambda group: scenes.index(group[0][0]))
    return [
        Entry(runs[0].label, scene, runs[0].budget, [run for run in runs if finished(run)])
        for (scene, _), runs in ordered
    ]


def comparable(found: Iterable[Entry]) -> list[list[Entry]]:
    """Group the entries that have finished runs by scene and number of frames."""
    groups: dict[tuple[str, int], list[Entry]] = {}
    for entry in found:
        if entry.runs:
            groups.setdefault((entry.scene, entry.budget), []).append(entry)
    return list(groups.values())


def success_in_tests(rows: Sequence[Mapping[str, float]]) -> list[tuple[int, float]]:
    """Return the frame count and success of each test in a training's history."""
    return [
        (int(row["frames"]), row["test_success"]) for row in rows if not math.isnan(row.get("test_success", math.nan))
    ]


def success_near(rows: Sequence[Mapping[str, float]], frames: int) -> float | None:
    """Return the success in the test nearest to a number of frames; None if no test is within one batch of it."""
    taken = success_in_tests(rows)
    if not taken:
        return None
    at, success = min(taken, key=lambda test: abs(test[0] - frames))
    before, after = [0.0, *(row["frames"] for row in rows)][-2:]  # the first row may count demonstrations
    return success if abs(at - frames) < after - before else None
