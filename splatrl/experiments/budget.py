"""Estimates of how much training is left, and how long it will take."""

from collections.abc import Sequence
from dataclasses import dataclass

from splatrl.experiments.experiment import Experiment
from splatrl.experiments.folders import evaluation, finished, frames_done


@dataclass(frozen=True)
class Budget:
    """Progress and remaining cost of the trainings of one experiment.

    Attributes:
        name: name of the experiment.
        trainings: number of trainings.
        finished: number of finished trainings.
        seeds: seeds of the trainings.
        frames: total frames of all trainings.
        frames_left: frames still to be trained.
        speed: frames per second of one training.
        measured: number of finished trainings used to measure the speed; 0 if it comes from the experiment's YAML.
        seconds_left: time left if the trainings run one at a time, seconds.
    """

    name: str
    trainings: int
    finished: int
    seeds: tuple[int, ...]
    frames: int
    frames_left: int
    speed: float
    measured: int
    seconds_left: float

    def __str__(self) -> str:
        source = f"measured over {self.measured} finished trainings" if self.measured else "expected"
        seeds = ", ".join(map(str, self.seeds))
        return (
            f"{self.name:<14} {self.trainings} trainings, seeds {seeds}, {self.frames:,} frames; "
            f"{self.finished} trainings done, {self.frames_left:,} frames left at {self.speed:,.0f} frames/s ({source})"
        )


def budget(experiment: Experiment) -> Budget:
    """Count finished and remaining frames; time is estimated at the finished trainings' speed, or the expected one."""
    ended = [run for run in experiment.runs if finished(run)]
    left = [run for run in experiment.runs if run not in ended]
    figures = [evaluation(run.folder) for run in ended]
    frames, seconds = (sum(values[key] for values in figures) for key in ("frames", "wall_seconds"))
    speed = frames / seconds if seconds else experiment.frames_per_second
    done = [frames_done(run.folder) for run in left]  # demonstrations may overshoot run.frames
    frames_left = sum(max(run.frames - frames, 0) for run, frames in zip(left, done, strict=True))
    return Budget(
        name=experiment.name,
        trainings=len(experiment.runs),
        finished=len(ended),
        seeds=tuple(sorted({run.seed for run in experiment.runs})),
        frames=sum(run.frames for run in experiment.runs),
        frames_left=frames_left,
        speed=speed,
        measured=len(ended) if seconds else 0,
        seconds_left=frames_left / speed + experiment.overhead * len(left),
    )


def statement(budgets: Sequence[Budget], jobs: int) -> str:
    """Format all budgets and their total, one per line.

    Args:
        budgets: budgets of the experiments.
        jobs: number of trainings that run at a time.
    """
    trainings, left = (sum(values) for values in zip(*((b.trainings, b.frames_left) for b in budgets), strict=True))
    minutes = sum(each.seconds_left for each in budgets) / jobs / 60
    time = f"{minutes / 60:.1f} h" if minutes >= 60 else f"{minutes:.0f} min"
    done = sum(each.finished for each in budgets)
    total = f"{trainings - done} of {trainings} trainings to do, {left:,} frames, about {time}, {jobs} at a time"
    return "\n".join([*map(str, budgets), total])
