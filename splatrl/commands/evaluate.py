"""``splatrl-evaluate``: evaluate a finished or interrupted run over its start set."""

import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig, OmegaConf

from splatrl.commands.entries import evaluate as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import (
    NAMES_OR_PATHS,
    PATHS,
    check_config,
    check_values,
    conf_dir,
    config_elsewhere,
    options,
    quoted,
)
from splatrl.configuration.grammar import bare
from splatrl.documents import read_yaml
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.episode_sets import MOST_EPISODES, require_episodes
from splatrl.evaluation.evaluate import EvaluationSettings, evaluate, summary_lines
from splatrl.files import remove_stale, replacing, require_room
from splatrl.runs import load_policy
from splatrl.training import Actor

PLACE = "place.yaml"
"""File in a folder of results: what was typed, the overrides of the place and settings of the evaluation."""
SETTINGS = ("checkpoint", "starts", "repeats", "seed")
"""Settings of an evaluation whose results, when typed, are kept apart from the run's own."""


def evaluate_run(
    cfg: DictConfig,
    folder: Path,
    world: World | Worlds | None = None,
    results: Path | None = None,
    place: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Evaluate the run in a folder with a given config, and print the results.

    Args:
        cfg: config of the run, including the evaluation settings.
        folder: the run folder.
        world: the world built from ``cfg``, if it exists already.
        results: folder for numbers and pictures; None is the run folder.
        place: what was typed to make ``cfg`` of the run's own; see ``load_policy``.

    Raises:
        OSError: if ``results`` cannot be written to; the message names it.
    """
    results = results or folder
    require_room(results)
    trained = load_policy(folder, cfg=cfg, world=world, place=place)
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
    folder, results = Path(cfg.run), None
    words = [_absolute(str(word)) for word in cfg.place]
    own = config_elsewhere(folder, words, cfg.allow_targets)
    words += [f"{key}={cfg[key]}" for key in SETTINGS if cfg[key] is not None]
    if cfg.episodes:
        words.append(f"episodes={Path(str(cfg.episodes)).absolute()}")
    typed = words if cfg.out is None else [f"run={quoted(folder.absolute())}", *words]
    if cfg.out is not None:
        results = _chosen_folder(Path(str(cfg.out)), typed)
    elif words:
        results = _results_folder(folder / "places", words)
    if cfg.episodes and cfg.starts is None:
        cfg.starts = MOST_EPISODES  # a file is evaluated whole
    for key in (*SETTINGS, "episodes"):
        if cfg[key] is not None:
            OmegaConf.update(own, f"evaluation.{key}", cfg[key])
    check_values(own)
    if own.evaluation.episodes is not None:
        require_episodes(Path(str(own.evaluation.episodes)))
    own.logger.video = cfg.video
    own.device = cfg.device or own.device
    torch.set_num_threads(own.threads)
    if cfg.out is None:
        _require_room(folder)
    with nullcontext() if results is None else _made(results, typed):
        remove_stale(results or folder)
        evaluate_run(own, folder, results=results, place=words)


def _absolute(word: str) -> str:
    """Return an override, with its value made absolute if it is the path of a scene or of another file."""
    key, _, value = word.partition("=")
    path = bare(value)
    is_path = key in ("scene", *PATHS, *NAMES_OR_PATHS) and path and path not in options(key) and Path(path).exists()
    return f"{key}={quoted(Path(path).absolute())}" if is_path else word


def _results_folder(places: Path, words: Sequence[str]) -> Path:
    """Return the folder for results apart from the run's own: named after scene or file, and whatever else was typed.

    Another place of the same name gets a number.
    """
    known = []
    for word in words:
        key, _, value = word.partition("=")
        text = Path(bare(value)).stem.removesuffix(".json") if "/" in value else value
        known.append(text if key == "scene" else f"{key}={text}")
    name = re.sub(r"[^\w.=-]+", "-", "-".join(dict.fromkeys(known)))[:100]
    numbered = (places / name if number == 1 else places / f"{name}-{number}" for number in itertools.count(1))
    return next(path for path in numbered if not (path / PLACE).exists() or read_yaml(path / PLACE) == list(words))


def _chosen_folder(out: Path, typed: Sequence[str]) -> Path:
    """Return the folder that was typed for results.

    Raises:
        ValueError: if it holds anything but an earlier evaluation of the same run with the same settings.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"out: expected a folder, got {out}, a file")
    known = read_yaml(out / PLACE) if (out / PLACE).exists() else None
    if known != list(typed) and out.exists() and any(out.iterdir()):
        raise ValueError(
            f"out: expected a new folder, or that of the same evaluation, got {out}, which holds other files"
        )
    return out


def _require_room(folder: Path) -> None:
    """Check that a run folder can be written to, and if not, say how to write elsewhere."""
    try:
        require_room(folder)
    except OSError as error:
        raise OSError(f"{folder}: {error.strerror}; choose another folder with out=") from error


@contextmanager
def _made(folder: Path, words: Sequence[str]) -> Iterator[None]:
    """Create a results folder with a record of what was typed, and remove both if the block adds nothing."""
    new = [path for path in (folder, folder.parent) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / PLACE) as stream:
        stream.write(OmegaConf.to_yaml(OmegaConf.create(list(words))).encode())
    try:
        yield
    finally:
        if [path.name for path in folder.iterdir()] == [PLACE]:
            (folder / PLACE).unlink()
        with suppress(OSError):  # rmdir fails on folders with content, which stay
            for path in new:
                path.rmdir()


if __name__ == "__main__":
    main()
