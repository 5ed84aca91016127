"""Policies tested in places that their training never saw."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.envs.tasks import NavigationTask
from splatrl.evaluation.report import summarise, write_json
from splatrl.evaluation.rollouts import knowing, run_episodes, spread_starts
from splatrl.experiments.experiment import Run
from splatrl.experiments.transfer import kept, score_in

PLACES = "places.json"
TESTED_IN = ("unseen_yards", "backyard", "kitchen")
"""Names of scenes in ``conf/experiment.yaml``."""
UNSEEN = 8
"""Width and height of views at which nobody looks, pixels."""


def choose_places(folder: Path, scenes: Mapping[str, Sequence[str]]) -> None:
    """Write the places in which policies will be tested into the experiment's folder.

    Args:
        folder: of the experiment.
        scenes: overrides of the scenes whose files are given, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / PLACES, {name: list(scenes[name]) for name in TESTED_IN if name in scenes})


def score_in_places(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Test finished runs in each of the chosen places, see ``score_everywhere``, and who never learned as well.

    Args:
        runs: of one task.
        folder: of the experiment, with the places.
    """
    chosen: dict[str, list[str]] = json.loads((folder / PLACES).read_text())
    same = [word for word in runs[0].overrides if not word.startswith("scene")]
    places = {name: load_config([*overrides, *same]) for name, overrides in chosen.items()}
    return [*score_in(runs, places), *(row for name, cfg in places.items() for row in unlearned(name, cfg))]


def unlearned(name: str, place: DictConfig) -> list[dict[str, Any]]:
    """What those reach who never learned: one goes straight at the goal, and the teacher knows the shortest way.

    Args:
        name: of the place.
        place: its config. Robots do not look, so that what they see is small.

    Returns:
        Rows as ``score_in`` gives them, with a ``label`` in place of a run; none for a task that tells no goal.
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
    for label, act in (("straight at the goal", task.beeline), ("the teacher, by the shortest way", task.teach)):
        episodes = run_episodes(env, knowing(env, act), starts.state, scene=starts.scene, memory=starts.memory)
        rates = summarise(episodes, episodes, None)
        rows.append({"label": label, "place": name, "starts": len(starts.state), **kept(rates)})
    return rows
