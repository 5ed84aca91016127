"""Conducts experiments: trains, scores and reports, and resumes after an interruption."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from splatrl.building import scene_digest
from splatrl.documents import read_json, write_json
from splatrl.experiments.experiment import Experiment, Run
from splatrl.experiments.folders import changes, finished, status
from splatrl.experiments.machine import machine
from splatrl.experiments.report import MACHINE, SCORES, write_joint_report, write_report
from splatrl.experiments.running import train
from splatrl.files import alone_in, discard, remove_stale

Score = Callable[[Sequence[Run], Path], list[dict[str, Any]]]
"""Scoring function: maps finished runs and their experiment's folder to rows for ``scores.json``.

Rows have ``run`` and either ``clip``, ``frames`` and ``matches`` (see ``clip_scores``), or ``place`` and rates (see
``transfer``).
"""


def check_settings(runs: Sequence[Run], fresh: bool, digest: Callable[[DictConfig], str] = scene_digest) -> None:
    """Refuse to mix settings or scenes: a run folder trained with others is an error, or is deleted on request.

    Args:
        runs: runs that are to be trained or resumed.
        fresh: whether to delete folders with other settings, another scene or files with other content.
        digest: returns the digest of a config's scene.

    Raises:
        ValueError: if anything differs; the message names the folder, its settings and the requested ones.
    """
    digests: dict[str, str] = {}

    def known(cfg: DictConfig) -> str:
        scene = OmegaConf.to_yaml(cfg.scene, resolve=True)
        digests[scene] = digests.get(scene) or digest(cfg)
        return digests[scene]

    for run in runs:
        if status(run.folder, run.config) == "new":
            continue
        changed = changes(run.folder, run.config, known)
        if changed and not fresh:
            way_out = "type folder=<another>, or fresh=true to delete it and start over"
            told = "; ".join([*changed, way_out])
            raise ValueError(f"{run.folder} was trained with other settings or files: {told}")
        if changed:
            with alone_in(run.folder):
                discard(run.folder)


def train_all(experiments: Sequence[Experiment], jobs: int, cores: int, program: Sequence[str]) -> list[Run]:
    """Train all unfinished runs, queueing all experiments together, and record the machine.

    Args:
        experiments: the experiments to train.
        jobs: number of trainings that run at a time.
        cores: number of cores per training.
        program: the command that trains; see ``running.command``.

    Returns:
        The runs that failed.
    """
    todo = [e for e in experiments if not all(map(finished, e.runs))]
    for experiment in todo:
        experiment.folder.mkdir(parents=True, exist_ok=True)
        remove_stale(experiment.folder)
        write_json(experiment.folder / MACHINE, {"machine": machine(jobs)})
        (experiment.folder / SCORES).unlink(missing_ok=True)
    return train([run for experiment in experiments for run in experiment.runs], jobs, cores, program)


def score(experiment: Experiment, scored_by: Score) -> bool:
    """Score an experiment once all its runs are finished; return whether scores are new.

    They are not if just these runs were scored before, rather than those of other seeds or scenes.

    Args:
        experiment: the experiment to score.
        scored_by: the function that computes the scores.

    Raises:
        ValueError: if another process is scoring the same experiment.
    """
    path, names = experiment.folder / SCORES, sorted(run.folder.name for run in experiment.runs)
    if not all(map(finished, experiment.runs)):
        return False
    if path.exists() and read_json(path).get("runs") == names:
        return False
    with alone_in(experiment.folder):
        write_json(path, {"runs": names, "scores": scored_by(experiment.runs, experiment.folder)})
    return True


def report_all(experiments: Sequence[Experiment], folder: Path, computer: str) -> list[Path]:
    """Write a report of each experiment, and a joint one if there are several; return the files.

    Args:
        experiments: the experiments to report.
        folder: folder of the joint report.
        computer: description of the machine, in words.
    """
    reports = [write_report(experiment, computer) for experiment in experiments]
    return [*reports, write_joint_report(experiments, folder, computer)] if len(experiments) > 1 else reports
