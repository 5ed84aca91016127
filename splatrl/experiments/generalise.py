"""Tests of policies in places that their training never saw."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from torch import Tensor

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.documents import read_json, write_json
from splatrl.envs.tasks import NavigationTask
from splatrl.envs.tasks.base import Memory
from splatrl.evaluation.report import summarise
from splatrl.evaluation.rollouts import knowing, run_episodes
from splatrl.evaluation.starts import spread_starts
from splatrl.experiments.experiment import Run
from splatrl.experiments.report import SCORES
from splatrl.experiments.transfer import kept, score_in
from splatrl.files import digest_of, expanded
from splatrl.geometry import azimuths, wrapped
from splatrl.made_with import files_of
from splatrl.scenes.blocks import scene_place

PLACES = "places.json"
TESTED_IN = ("unseen_yards", "backyard", "kitchen")
"""Scenes of ``conf/experiment.yaml`` in which policies are tested."""
UNSEEN = 8
"""Width and height of images that no policy looks at, pixels."""


def choose_places(folder: Path, scenes: Mapping[str, Sequence[str]]) -> None:
    """Write the list of test places into the experiment's folder; scores in other places are removed.

    Args:
        folder: folder of the experiment.
        scenes: overrides, by name, of the scenes whose files are given.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / PLACES
    chosen = {
        name: {"overrides": list(scenes[name]), "files": _digest(scenes[name])} for name in TESTED_IN if name in scenes
    }
    if path.exists() and read_json(path) != chosen:
        (folder / SCORES).unlink(missing_ok=True)
    write_json(path, chosen)


def _digest(overrides: Sequence[str]) -> str | None:
    """Return a digest of a scene's files; None for a scene that splatrl generates."""
    path = load_config(overrides).scene.get("path")
    return None if path is None else digest_of(files_of(scene_place(expanded(path))))


def score_in_places(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Test finished runs in each of the chosen places (see ``score_everywhere``), together with untrained baselines.

    Args:
        runs: finished runs of one task.
        folder: folder of the experiment, which holds the list of places.
    """
    chosen = read_json(folder / PLACES)
    same = [word for word in runs[0].overrides if not word.startswith("scene")]
    places = {name: load_config([*place["overrides"], *same]) for name, place in chosen.items()}
    return [*score_in(runs, places), *(row for name, cfg in places.items() for row in unlearned(name, cfg))]


def unlearned(name: str, place: DictConfig) -> list[dict[str, Any]]:
    """Test two baselines that never learned: one heads straight for the goal, the other is the shortest-path teacher.

    Args:
        name: name of the place.
        place: config of the place; images are shrunk to ``UNSEEN``, since neither baseline looks at them.

    Returns:
        Rows as from ``score_in``, with ``label`` in place of ``run``; none unless the task is a navigation task.
    """
    place = place.copy()
    place.robot.image_width = place.robot.image_height = UNSEEN
    world = build_world(place)
    task = world.task
    if not isinstance(task, NavigationTask):
        return []
    starts = spread_starts(world, place.evaluation.starts)
    env = world.env(min(place.evaluation.batch_size, len(starts.state)))
    rows = []
    for label, act in (("straight to the goal", partial(beeline, task)), ("shortest-path teacher", task.teach)):
        episodes = run_episodes(env, knowing(env, act), starts.state, scene=starts.scene, memory=starts.memory)
        rates = summarise(episodes, episodes, None)
        rows.append({"label": label, "place": name, "starts": len(starts.state), **kept(rates)})
    return rows


def beeline(task: NavigationTask, state: Tensor, memory: Memory) -> Tensor:
    """Return the actions [B, ...] of an agent that knows the goal's distance and direction alone; see ``teach``."""
    x, y, yaw = task.motion.planar(state).float().unbind(1)
    away = memory["goal"][:, :2] - torch.stack([x, y], 1)
    return task.steering.toward(wrapped(azimuths(away) - yaw), away.norm(dim=1) < task.success_distance)
