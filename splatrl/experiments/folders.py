"""Contents of a run folder: training progress, settings and results."""

import csv
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration import differences_from_run, with_absolute_paths
from splatrl.evaluation.evaluate import RESULTS, SCENES_SHOWN
from splatrl.evaluation.pictures import VIDEO
from splatrl.experiments.experiment import Run
from splatrl.made_with import changed_content, made_with
from splatrl.training import load_checkpoint

Status = Literal["finished", "begun", "new"]


def status(folder: Path, config: Mapping[str, Any]) -> Status:
    """Return whether a training is finished and evaluated, has begun and can be resumed, or is new.

    An evaluation alone does not count: interrupted trainings can be evaluated, too.

    Args:
        folder: the run folder.
        config: the training's config.
    """
    collector = config["collector"]
    ended = frames_done(folder) + int(collector["frames_per_batch"]) > int(collector["total_frames"])
    if ended and (folder / RESULTS).exists() and (not config["logger"]["video"] or _filmed(folder)):
        return "finished"
    checkpoints = (folder / "checkpoints" / f"{name}.pt" for name in ("last", "previous"))
    return "begun" if any(path.exists() for path in checkpoints) else "new"


def finished(run: Run) -> bool:
    """Return whether a training of an experiment is finished and evaluated."""
    return status(run.folder, run.config) == "finished"


def _filmed(folder: Path) -> bool:
    """Return whether an evaluation has written all its videos, one for each scene that it shows."""
    scenes = evaluation(folder).get("scenes", [])
    if not scenes:
        return (folder / VIDEO).exists()
    return len(list(folder.glob(f"scenes/*/{VIDEO}"))) >= min(len(scenes), SCENES_SHOWN)


def changes(folder: Path, config: Mapping[str, Any], digest: Callable[[DictConfig], str] | None) -> list[str]:
    """List how the run in a folder differs from what is asked for, in settings, scene and files.

    Args:
        folder: the run folder, which has a config.
        config: the config that is asked for.
        digest: returns the digest of a config's scene; None compares settings alone.
    """
    changed = differences_from_run(config, folder)
    if changed or digest is None or not (then := began_with(folder)):
        return changed
    cfg = config if isinstance(config, DictConfig) else OmegaConf.create(dict(config))
    return changed_content(made_with(with_absolute_paths(cfg), digest(cfg)), then)


def began_with(folder: Path) -> dict[str, Any]:
    """Return the ``made_with`` that a training keeps in its checkpoints; empty if it has none that can be read."""
    for name in ("last", "previous"):
        with suppress(FileNotFoundError, ValueError):
            kept: dict[str, Any] = load_checkpoint(folder / "checkpoints" / f"{name}.pt").get("made_with", {})
            return kept
    return {}


def evaluation(folder: Path) -> dict[str, Any]:
    """Read a run's ``evaluation.json``."""
    result: dict[str, Any] = json.loads((folder / RESULTS).read_text())
    return result


def history(folder: Path) -> list[dict[str, float]]:
    """Read the rows of ``progress.csv``, with NaN for empty cells; a missing file gives no rows."""
    path = folder / "progress.csv"
    if not path.exists():
        return []
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [{key: float(value) if value else math.nan for key, value in row.items()} for row in rows]


def frames_done(folder: Path) -> int:
    """Return how many frames a training has completed, according to its ``progress.csv``."""
    rows = history(folder)
    return int(rows[-1]["frames"]) if rows else 0
