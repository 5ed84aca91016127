"""Sweeps of trainings: one that was interrupted continues in its folder."""

import re
import shlex
from pathlib import Path

from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from splatrl.building import scene_digest
from splatrl.commands.entries import TYPED
from splatrl.commands.stopping import INTERRUPTED
from splatrl.configuration import RUN_CONFIG, quoted
from splatrl.configuration.sweep_folders import SWEEP_DIR, check_same
from splatrl.experiments.folders import changes, evaluation, status

PLAIN = re.compile(r"[\w./+-]+")
"""A path that needs no quotes in Hydra's grammar."""


def earlier(cfg: DictConfig, folder: Path) -> float | None:
    """Return the result of a job of a sweep that is finished; set ``cfg.resume`` for one that was interrupted.

    Args:
        cfg: config of the job.
        folder: folder of the job.

    Raises:
        ValueError: if the folder holds a run of other settings, or of files with other content.
    """
    if not (folder / RUN_CONFIG).exists():
        return None
    check_same(folder, changes(folder, cfg, scene_digest))
    if (found := status(folder, cfg)) == "finished":
        return float(evaluation(folder)["success_rate"])
    if found == "begun":
        cfg.resume = str(folder)
    return None


def continuation(job: HydraConf, folder: Path) -> str:
    """Return how a training continues, with the rest of the sweep that it belongs to.

    The processes of launchers do not know what was typed; there, it is the command for the training alone.

    Args:
        job: the training as a job of Hydra's.
        folder: the run folder.
    """
    if job.mode != RunMode.MULTIRUN or not TYPED:
        return f"continue with: splatrl-train {shlex.quote(f'resume={folder}')}"
    return f"continue with: {_same_sweep(job)}"


def continuation_of_sweep(ended: BaseException) -> str | None:
    """Return how the sweep of this process continues; None if there is none, or if its training has said so already.

    Args:
        ended: what ended the sweep. A launcher may pass on how a training in another process ended.
    """
    if not HydraConfig.initialized() or (sweep := HydraConfig.get()).mode != RunMode.MULTIRUN:
        return None
    alone = str(sweep.launcher._target_).endswith(f".{BasicLauncher.__name__}")
    if isinstance(ended, SystemExit) and (alone or ended.code != INTERRUPTED) and not crashed(ended):
        return None
    first = "" if alone else "jobs on a cluster run on; when they have ended or been cancelled, "
    return f"{first}continue with: {_same_sweep(sweep)}"


def crashed(ended: BaseException) -> bool:
    """Whether Hydra ended the program after a traceback, as when memory ran out or a launcher's process was killed."""
    error = ended.__context__ if isinstance(ended, SystemExit) and ended.code == 1 else None  # others end with a line
    return isinstance(error, Exception) and not isinstance(error, CompactHydraException)


def _same_sweep(job: HydraConf) -> str:
    place = str(Path(job.runtime.cwd, job.sweep.dir))
    words = [word for word in TYPED if not word.startswith(f"{SWEEP_DIR}=")]
    return shlex.join(["splatrl-train", *words, f"{SWEEP_DIR}={place if PLAIN.fullmatch(place) else quoted(place)}"])
