"""``splatrl-evaluate``: evaluate a finished or interrupted run over its start set."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig, OmegaConf

from splatrl.commands.entries import evaluate as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import check_config, conf_dir, config_elsewhere, run_config
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.evaluate import EvaluationSettings, evaluate, summary_lines
from splatrl.files import require_room
from splatrl.runs import load_policy
from splatrl.training import Actor


def evaluate_run(
    cfg: DictConfig, folder: Path, world: World | Worlds | None = None, results: Path | None = None
) -> dict[str, Any]:
    """Evaluate the run in a folder with a given config, and print the results.

    Args:
        cfg: config of the run, including the evaluation settings.
        folder: the run folder.
        world: the world built from ``cfg``, if it exists already.
        results: folder for numbers and pictures; None is the run folder.

    Raises:
        OSError: if ``results`` cannot be written to; the message names it.
    """
    results = results or folder
    require_room(results)
    trained = load_policy(folder, cfg=cfg, world=world)
    settings = EvaluationSettings(**cfg.evaluation)
    policy, checkpoint = Actor(trained.model, judges=False), trained.checkpoint
    summary, files = evaluate(trained.world, policy, checkpoint, results, settings, cfg.seed, cfg.logger.video)
    print("\n".join(summary_lines(summary)))
    print(f"pictures in {results}: {', '.join(str(path.relative_to(results)) for path in files)}")
    return summary


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="evaluate")
@in_one_line("splatrl-evaluate")
def run(cfg: DictConfig) -> None:
    """Evaluate the run folder ``cfg.run`` with its own config."""
    check_config(cfg)
    folder, results = Path(cfg.run).expanduser(), None
    words = [str(word) for word in cfg.place]
    own = config_elsewhere(folder, words, cfg.allow_targets) if words else run_config(folder, cfg.allow_targets)
    if cfg.episodes:
        words.append(f"episodes={Path(str(cfg.episodes)).name.split('.')[0]}")
    if words:
        results = folder / "places" / _name(words)
    for key in ("checkpoint", "starts", "repeats", "seed", "episodes"):
        if cfg[key] is not None:
            OmegaConf.update(own, f"evaluation.{key}", cfg[key])
    own.logger.video = cfg.video
    own.device = cfg.device or own.device
    torch.set_num_threads(own.threads)
    with _made(results):
        evaluate_run(own, folder, results=results)


@contextmanager
def _made(folder: Path | None) -> Iterator[None]:
    """Create a results folder for the block, and remove it afterwards if it is still empty."""
    if folder is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # rmdir fails on folders with content, which stay
            for path in (folder, folder.parent):
                path.rmdir()


def _name(words: Sequence[str]) -> str:
    """Derive a folder name for a place from its overrides: its scene or file, and whatever else was typed."""
    values = [word.partition("=")[2].strip("'\"") for word in words]
    known = [
        Path(value).resolve().stem if Path(value).expanduser().exists() else word.removeprefix("scene=")
        for word, value in zip(words, values, strict=True)
    ]
    return re.sub(r"[^\w.=-]+", "-", "-".join(dict.fromkeys(known)))[:100]


if __name__ == "__main__":
    main()
