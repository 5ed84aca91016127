"""``splatrl-experiment``: train everything that an experiment of the paper asks for, and report what came out."""

import shutil
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import hydra
from hydra.errors import HydraException
from hydra.utils import get_method
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationToMissingValueError, OmegaConfBaseException

from splatrl.configuration import check_overrides, conf_dir, load_config, run_config
from splatrl.evaluation.report import write_json
from splatrl.experiments import (
    Experiment,
    Run,
    Selection,
    budget,
    planned,
    statement,
    train,
    write_joint_report,
    write_report,
)
from splatrl.experiments.folders import differences, status
from splatrl.experiments.machine import machine
from splatrl.experiments.report import MACHINE, SCORES
from splatrl.native.threads import usable_cores

Score = Callable[[Sequence[Run], Path], list[dict[str, Any]]]
"""From finished runs and the folder of their experiment to rows of ``run``, ``clip``, ``frames`` and ``matches``."""


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="experiment")
def run(cfg: DictConfig) -> None:
    """Train and report the experiment ``cfg.name``, or all of them."""
    try:
        experiment(cfg)
    except ValueError as error:
        sys.exit(f"splatrl-experiment: {error}")


def experiment(cfg: DictConfig) -> None:
    """Do what a config asks for.

    Args:
        cfg: of ``conf/experiment.yaml``.

    Raises:
        ValueError: for a name, scene or setting that is refused.
        SystemExit: names the trainings that failed, once all others are done.
    """
    names = _names(cfg)
    scenes = _scenes(cfg)
    folder = Path(cfg.folder)
    selection = Selection(*(_plain(cfg)[key] for key in ("seeds", "frames", "scenes")))
    nodes = _plain(cfg.experiments)
    experiments = [planned(name, nodes[name], scenes, folder, _compose, selection) for name in names]
    runs = [each for asked in experiments for each in asked.runs]
    if not runs:
        raise ValueError(f"name={cfg.name}: expected at least one training, got none with these seeds and scenes")
    jobs, cores = cfg.jobs or usable_cores(), usable_cores()
    failed: list[Run] = []
    if not cfg.report_only:
        _check_settings(runs, cfg.fresh)
        print(statement([budget(asked) for asked in experiments], min(jobs, len(runs))), flush=True)
        failed = _train(experiments, jobs, max(1, cores // jobs))
    reports = _report(experiments, folder, machine(jobs))
    scored = not cfg.report_only and [_score(asked, nodes[asked.name]["score"]) for asked in experiments]
    if scored and any(scored):
        reports = _report(experiments, folder, machine(jobs))
    print("\n".join(f"report in {path}" for path in reports))
    if failed:
        sys.exit("\n".join(["failed:", *(f"{each.folder}: see log.txt there" for each in failed)]))


def _train(experiments: Sequence[Experiment], jobs: int, threads: int) -> list[Run]:
    """Train what is not finished, all experiments in one queue, and note on what machine."""
    todo = [e for e in experiments if any(status(run) != "finished" for run in e.runs)]
    for experiment in todo:
        experiment.folder.mkdir(parents=True, exist_ok=True)
        write_json(experiment.folder / MACHINE, {"machine": machine(jobs)})
        (experiment.folder / SCORES).unlink(missing_ok=True)
    try:
        return train([run for experiment in experiments for run in experiment.runs], jobs, threads)
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on", file=sys.stderr)
        sys.exit(130)


def _report(experiments: Sequence[Experiment], folder: Path, computer: str) -> list[Path]:
    """Write the report of each, and one of all where there are several."""
    reports = [write_report(experiment, computer) for experiment in experiments]
    return [*reports, write_joint_report(experiments, folder, computer)] if len(experiments) > 1 else reports


def _score(experiment: Experiment, name: str | None) -> bool:
    """Score an experiment all of whose runs are finished, once; tells whether there are new scores."""
    path = experiment.folder / SCORES
    if name is None or path.exists() or any(status(run) != "finished" for run in experiment.runs):
        return False
    score = cast(Score, get_method(name))
    write_json(path, {"scores": score(experiment.runs, experiment.folder)})
    return True


def _names(cfg: DictConfig) -> list[str]:
    names = [str(name) for name in cfg.experiments]
    given = None if OmegaConf.is_missing(cfg, "name") else cfg.name
    if given != "all" and given not in names:
        raise ValueError(f"name: expected one of {', '.join([*names, 'all'])}, got {given or 'nothing'}")
    return names if given == "all" else [given]


def _scenes(cfg: DictConfig) -> dict[str, list[str]]:
    """Overrides of the scenes that can be trained in: those whose files are given."""
    known = [str(scene) for scene in cfg.scene_overrides]
    for scene in cfg.scenes or []:
        if scene not in known:
            raise ValueError(f"scenes: expected some of {', '.join(known)}, got {scene}")
    result = {}
    for scene in cfg.scenes or known:
        try:
            result[scene] = [str(override) for override in cfg.scene_overrides[scene]]
        except InterpolationToMissingValueError as error:
            if cfg.scenes is not None:
                raise ValueError(f"scenes={scene}: expected {scene}=<its file> beside it, got none") from error
            print(f"{scene} is left out; to have it, give {scene}=<its file>", file=sys.stderr)
    return result


def _check_settings(runs: Sequence[Run], fresh: bool) -> None:
    """Refuse to mix settings: a folder that was trained with others is an error, or is deleted when that is asked for.

    Raises:
        ValueError: names the folder, and what it was trained with beside what is asked for.
    """
    for each in runs:
        if status(each) == "new":
            continue
        changed = differences(each.config, _plain(run_config(each.folder)))
        if changed and not fresh:
            lines = [f"{each.folder} was trained with other settings:", *(f"  {line}" for line in changed)]
            raise ValueError("\n".join([*lines, "give folder=<another>, or fresh=true to delete it and begin anew"]))
        if changed:
            shutil.rmtree(each.folder)


def _compose(overrides: Sequence[str]) -> dict[str, Any]:
    try:
        return _plain(load_config(overrides))
    except (HydraException, OmegaConfBaseException) as error:
        raise ValueError(f"{' '.join(overrides)}: {error}") from error


def _plain(cfg: DictConfig) -> dict[str, Any]:
    result = cast(Mapping[str, Any], OmegaConf.to_container(cfg))
    return dict(result)


def main() -> None:
    """Entry point of the command."""
    check_overrides("experiment", sys.argv[1:])
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
