"""The folder of a sweep, in which an interrupted one continues, and nothing of another one is replaced."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, open_dict

from splatrl.configuration.differences import differences_from_run
from splatrl.configuration.loading import job_config
from splatrl.configuration.run_configs import RUN_CONFIG

SWEEP_DIR = "hydra.sweep.dir"


class SameSweep(Callback):
    """Hydra callback that ends a sweep with one line if its folder holds a run of other settings than its job has.

    It does so before anything is written. Only the jobs of Hydra's own sweeper are known before they begin; those of
    other sweepers are compared as they begin.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Compare the config of each job with that of the run in its folder."""
        if not str(config.hydra.sweeper._target_).endswith(f".{BasicSweeper.__name__}"):
            return
        if not any(Path(config.hydra.sweep.dir).rglob(RUN_CONFIG)):
            return
        with suppress(HydraException):  # which Hydra will report
            for number, cfg, folder in _jobs(config):
                try:
                    if (folder / RUN_CONFIG).exists():
                        check_same(folder, differences_from_run(cfg, folder))
                except ValueError as error:
                    sys.exit(f"splatrl-{config.hydra.job.name}: job #{number}: {error}")


def check_same(folder: Path, changed: Sequence[str]) -> None:
    """Refuse the folder of a run that differs from what is asked for.

    Args:
        folder: the run folder.
        changed: what differs, a line each.

    Raises:
        ValueError: if anything does.
    """
    if changed:
        told = "; ".join([*changed, f"choose another folder with {SWEEP_DIR}="])
        raise ValueError(f"{folder}: expected no run, or one of the same settings and files, got another: {told}")


def _jobs(config: DictConfig) -> Iterator[tuple[int, DictConfig, Path]]:
    """Yield number, config and folder of each job of a sweep that trains in a folder of its own."""
    loader, hydra = GlobalHydra.instance().config_loader(), HydraConfig.instance()
    words = [f"{key}={value}" for key, value in (config.hydra.sweeper.params or {}).items()]
    overrides = OverridesParser.create(loader).parse_overrides([*words, *config.hydra.overrides.task])
    before = hydra.cfg
    try:
        for number, typed in enumerate(BasicSweeper.split_arguments(overrides, None)[0]):
            job = loader.load_sweep_config(config, list(typed))
            with open_dict(job):
                job.hydra.job.id = job.hydra.job.num = number
            hydra.set_config(job)
            folder = Path(job.hydra.sweep.dir) / str(job.hydra.sweep.subdir)
            with open_dict(job):
                del job["hydra"]
            if not job.get("resume"):
                yield number, job_config(job, typed), folder
    finally:
        hydra.cfg = before
