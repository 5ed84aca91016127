"""What a run folder records: how far the training is, its settings and its results."""

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from splatrl.configuration import PATHS
from splatrl.experiments.experiment import Run

Status = Literal["finished", "begun", "new"]
SPEED_ONLY = {"threads", "renderer.threads", "resume", "collector.cuda_graph", "optim.compile"}
"""Keys of a config that do not change the results."""
VIDEO = "rollouts.mp4"
"""The last file that a run writes."""


def status(run: Run) -> Status:
    """Whether a training is finished, can be resumed, or has not begun."""
    filmed = (run.folder / VIDEO).exists() or not run.config["logger"]["video"]
    if (run.folder / "evaluation.json").exists() and filmed:
        return "finished"
    return "begun" if (run.folder / "checkpoints" / "last.pt").exists() else "new"


def evaluation(run: Run) -> dict[str, Any]:
    """The content of ``evaluation.json``."""
    result: dict[str, Any] = json.loads((run.folder / "evaluation.json").read_text())
    return result


def history(run: Run) -> list[dict[str, float]]:
    """The rows of ``progress.csv``, with NaN for empty cells; no rows if there is no file."""
    path = run.folder / "progress.csv"
    if not path.exists():
        return []
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [{key: float(value) if value else math.nan for key, value in row.items()} for row in rows]


def frames_done(run: Run) -> int:
    """Number of frames that a training has completed, according to its ``progress.csv``."""
    rows = history(run)
    return int(rows[-1]["frames"]) if rows else 0


def differences(asked: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """Keys in which two configs differ, with both values; keys that only change speed are left out."""
    wanted, there = dict(_flat(asked)), dict(_flat(found))
    return [
        f"{key}: asked for {wanted.get(key, 'nothing')}, found {there.get(key, 'nothing')}"
        for key in sorted(wanted.keys() | there.keys())
        if key not in SPEED_ONLY and wanted.get(key) != there.get(key)
    ]


def _flat(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, str(Path(value).expanduser().absolute()) if name in PATHS and value is not None else value
