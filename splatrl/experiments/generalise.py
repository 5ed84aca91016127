"""Policies tested in places that their training never saw."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splatrl.configuration import load_config
from splatrl.evaluation.report import write_json
from splatrl.experiments.experiment import Run
from splatrl.experiments.transfer import score_in

PLACES = "places.json"
TESTED_IN = ("unseen_yards", "backyard", "kitchen")
"""Names of scenes in ``conf/experiment.yaml``."""


def choose_places(folder: Path, scenes: Mapping[str, Sequence[str]]) -> None:
    """Write the places in which policies will be tested into the experiment's folder.

    Args:
        folder: of the experiment.
        scenes: overrides of the scenes whose files are given, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / PLACES, {name: list(scenes[name]) for name in TESTED_IN if name in scenes})


def score_in_places(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Test finished runs in each of the chosen places; see ``score_everywhere``.

    Args:
        runs: of one task.
        folder: of the experiment, with the places.
    """
    places: dict[str, list[str]] = json.loads((folder / PLACES).read_text())
    same = [word for word in runs[0].overrides if not word.startswith("scene")]
    return score_in(runs, {name: load_config([*overrides, *same]) for name, overrides in places.items()})
