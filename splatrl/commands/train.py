"""``splatrl-train``: train a policy, evaluate it, and write pictures to the run folder."""

import gc
import sys
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager, nullcontext
from pathlib import Path

import hydra
import torch
from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from splatrl.building import build_trainer, build_world, check_training
from splatrl.commands.entries import train as main
from splatrl.commands.evaluate import evaluate_run
from splatrl.commands.faults import CONFIGURED, in_one_line
from splatrl.commands.stopping import stoppable
from splatrl.commands.sweeps import continuation, continuation_of_sweep, crashed, earlier
from splatrl.configuration import (
    RUN_CONFIG,
    check_config,
    check_new,
    conf_dir,
    forget_run,
    job_config,
    place_configs,
    resumed_config,
    save_config,
)
from splatrl.device import device_line
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.evaluate import remove_results
from splatrl.evaluation.starts import given_episodes
from splatrl.files import alone_in
from splatrl.made_with import check_made_with
from splatrl.training import Trainer
from splatrl.viewer.page import Page
from splatrl.viewer.training import TrainingView


def run() -> None:
    """Run the command; a sweep that is interrupted, or crashes, says how it continues, whoever runs its jobs."""
    try:
        run_job()
    except (KeyboardInterrupt, SystemExit) as ended:
        if (told := continuation_of_sweep(ended)) is None:
            raise
        if crashed(ended):
            print(f"\nthe sweep failed; finished work is kept; {told}", file=sys.stderr)
            raise
        with stoppable(told):
            raise KeyboardInterrupt from None


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="train")
@in_one_line("splatrl-train")
def run_job(cfg: DictConfig) -> float:
    """Train and evaluate the policy that a config describes, or resume a run; return the success rate, for sweepers."""
    job = HydraConfig.get()
    with chdir(job.runtime.cwd) if job.job.chdir else nullcontext():  # relative paths begin where they were typed
        return trained(cfg, job)


def trained(cfg: DictConfig, job: HydraConf) -> float:
    """Train as a job of Hydra's, alone in its run folder; see ``run``."""
    if job.mode == RunMode.MULTIRUN:
        cfg = job_config(cfg, job.overrides.task)
    folder = Path(cfg.resume or job.runtime.output_dir)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: expected a run folder, found none")
    with alone_in(folder):
        if cfg.resume:
            cfg = resumed_config(folder, job.overrides.task)
            cfg.resume = str(folder)
        elif job.mode == RunMode.MULTIRUN and (result := earlier(cfg, folder)) is not None:
            print(f"{folder}: finished, success {result:.3f}")
            return result
        if not cfg.resume:
            check_new(folder)
        new = not cfg.resume and not (folder / RUN_CONFIG).exists()
        try:
            with stoppable(continuation(job, folder)):
                return train(cfg, folder)
        except CONFIGURED:
            if new and not any(folder.glob("checkpoints/*.pt")):
                forget_run(folder)
            raise


def train(cfg: DictConfig, folder: Path) -> float:
    """Train in a run folder, evaluate, and return the success rate.

    Args:
        cfg: the config; its ``resume`` says whether to continue the run in the folder, which began with this config.
        folder: the run folder.

    Raises:
        FileNotFoundError: for an ``evaluation.episodes`` that does not exist.
        ValueError: for a resumed run that began with other settings, episodes that do not fit the scene or task, or
            ``view`` with several scenes.
    """
    resume, cfg.resume = cfg.resume, None
    check_config(cfg)
    if cfg.view and (count := len(place_configs(cfg))) > 1:
        raise ValueError(f"view: expected a training in one scene, got {count} scenes; type view=false")
    check_training(cfg, not resume)
    if not resume:
        save_config(cfg, folder)
    torch.set_num_threads(cfg.threads)
    world = build_world(cfg)
    print(device_line(world.device))
    if cfg.evaluation.episodes is not None:
        given_episodes(world, Path(str(cfg.evaluation.episodes)))  # refuses a wrong file now, not after the training
    accepting = (lambda now, then: None) if cfg.resume_changed else check_made_with
    trainer = build_trainer(cfg, world, folder, accepting if resume else None)
    if resume:
        save_config(cfg, folder)
    gc.collect()
    # Modules and the world live as long as the process; rescanning them would take a tenth of the training time.
    gc.freeze()
    try:
        goes_on = not trainer.ppo.finished
        if goes_on:
            remove_results(folder)  # those of a part of this training
        with watched(cfg, world, trainer):
            trainer.fit()
        if goes_on:
            remove_results(folder)  # those of somebody who evaluated it meanwhile
        summary = evaluate_run(cfg, folder, world)
        if trainer.tracker is not None:
            trainer.tracker.scalars(evaluated(summary), trainer.ppo.frames)
            trainer.tracker.files(sorted([*folder.glob("*.png"), *folder.glob("*.mp4")]), trainer.ppo.frames)
    finally:
        if trainer.tracker is not None:
            trainer.tracker.close()
    return float(summary["success_rate"])


def evaluated(summary: Mapping[str, object]) -> dict[str, float]:
    """Prefix the rates of an evaluation with ``evaluation_``, so that a tracker keeps them apart from training's."""
    return {f"evaluation_{key}": value for key, value in summary.items() if isinstance(value, float)}


@contextmanager
def watched(cfg: DictConfig, world: World | Worlds, trainer: Trainer) -> Iterator[None]:
    """Show the training in a browser during the block, if ``cfg.view`` is set."""
    if not cfg.view:
        yield
        return
    assert isinstance(world, World), type(world)
    page = Page(world.scene)
    view = TrainingView(page, world, trainer)
    print(f"{page.address}: watch the training", flush=True)
    try:
        yield
    finally:
        view.close()
        page.close()


if __name__ == "__main__":
    main()
