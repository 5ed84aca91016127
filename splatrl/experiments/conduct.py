"""Experiments from beginning to end: what is trained, scored and reported, and what goes on after a stop."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from splatrl.configuration import run_config
from splatrl.evaluation.report import write_json
from splatrl.experiments.experiment import Experiment, Run
from splatrl.experiments.folders import differences, status
from splatrl.experiments.machine import machine
from splatrl.experiments.report import MACHINE, SCORES, write_joint_report, write_report
from splatrl.experiments.running import train

Score = Callable[[Sequence[Run], Path], list[dict[str, Any]]]
"""From finished runs and the folder of their experiment to rows of ``run``, ``clip``, ``frames`` and ``matches``."""


def check_settings(runs: Sequence[Run], fresh: bool) -> None:
    """Refuse to mix settings: a folder that was trained with others is an error, or is deleted when that is asked for.

    Args:
        runs: that are to be trained or gone on with.
        fresh: whether to delete folders of other settings.

    Raises:
        ValueError: names the folder, and what it was trained with beside what is asked for.
    """
    for run in runs:
        if status(run) == "new":
            continue
        found = OmegaConf.to_container(run_config(run.folder))
        assert isinstance(found, Mapping), type(found)
        changed = differences(run.config, {str(key): value for key, value in found.items()})
        if changed and not fresh:
            lines = [f"{run.folder} was trained with other settings:", *(f"  {line}" for line in changed)]
            raise ValueError("\n".join([*lines, "give folder=<another>, or fresh=true to delete it and begin anew"]))
        if changed:
            shutil.rmtree(run.folder)


def train_all(experiments: Sequence[Experiment], jobs: int, threads: int, program: Sequence[str]) -> list[Run]:
    """Train what is not finished, all experiments in one queue, and note on what machine.

    Args:
        experiments: whose trainings they are.
        jobs: at a time.
        threads: of the renderer of each.
        program: what trains; see ``running.command``.

    Returns:
        The runs that failed.
    """
    todo = [e for e in experiments if any(status(run) != "finished" for run in e.runs)]
    for experiment in todo:
        experiment.folder.mkdir(parents=True, exist_ok=True)
        write_json(experiment.folder / MACHINE, {"machine": machine(jobs)})
        (experiment.folder / SCORES).unlink(missing_ok=True)
    return train([run for experiment in experiments for run in experiment.runs], jobs, threads, program)


def score(experiment: Experiment, scored_by: Score) -> bool:
    """Score an experiment all of whose runs are finished, once; tells whether there are new scores.

    Args:
        experiment: to be scored.
        scored_by: gives the scores.
    """
    path = experiment.folder / SCORES
    if path.exists() or any(status(run) != "finished" for run in experiment.runs):
        return False
    write_json(path, {"scores": scored_by(experiment.runs, experiment.folder)})
    return True


def report_all(experiments: Sequence[Experiment], folder: Path, computer: str) -> list[Path]:
    """Write the report of each experiment, and one of all where there are several; returns the files.

    Args:
        experiments: to be reported.
        folder: of the joint report.
        computer: what they ran on, in words.
    """
    reports = [write_report(experiment, computer) for experiment in experiments]
    return [*reports, write_joint_report(experiments, folder, computer)] if len(experiments) > 1 else reports
