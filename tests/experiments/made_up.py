"""Made-up experiments and run folders: what trainings would have left, without training."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatrl.experiments import Experiment, Run, Selection, checked, planned

SCENES = {"yard": ["scene=yard"], "hall": ["scene=hall"]}
NODE: dict[str, Any] = {
    "title": "A title",
    "question": "Does it?",
    "paper": "It does.",
    "frames_per_second": 100,
    "overhead": 10,
    "marks": [200, 400],
    "threshold": 0.9,
    "arms": {
        "with": {"label": "with it", "overrides": ["curriculum=yes"], "scenes": ["yard", "hall"], "seeds": [0, 1]},
        "without": {"label": "without", "overrides": ["curriculum=no"], "scenes": ["yard"], "seeds": [0, 1]},
    },
}


def compose(overrides: Sequence[str]) -> dict[str, Any]:
    """Return the part of a config that is read: 430 frames in batches of 40, unless the overrides say otherwise."""
    given = dict(override.split("=", 1) for override in overrides)
    return {
        "collector": {"total_frames": int(given.get("collector.total_frames", 430)), "frames_per_batch": 40},
        "curriculum": {"first": 2 if given.get("curriculum") == "yes" else None},
        "logger": {"video": False},
        "scene": {"path": given["scene"]},
        "seed": 0,
        "threads": 1,
    }


def made_up(folder: Path, node: dict[str, Any] | None = None, selection: Selection | None = None) -> Experiment:
    """Plan the experiment above, or that of another node."""
    return planned("tried", checked("tried", node or NODE), SCENES, folder, compose, selection)


def begin(run: Run, frames: int, tested: Sequence[float] = ()) -> None:
    """Write what a training leaves after some frames: its history and a checkpoint.

    Args:
        run: the training.
        frames: number of frames that it has completed.
        tested: success rates of tests, one every 200 frames, that is, every minute of training.
    """
    checkpoint = run.folder / "checkpoints" / "last.pt"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    tests = dict(zip(range(200, 10_000, 200), tested, strict=False))
    keys = ["frames", "success", "episodes", "level", "test_success", "seconds"]
    with (run.folder / "progress.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(keys)
        for at in range(40, frames + 1, 40):
            success = "" if at == 40 else at / 1000
            writer.writerow([at, success, 5, 1 + at // 200, tests.get(at, ""), 0.3 * at])


def finish(run: Run, success: float, seconds: float = 5.0, tested: Sequence[float] = (0.5, 0.95)) -> None:
    """Write what a finished training leaves."""
    begin(run, run.frames, tested)
    figures = {"success_rate": success, "success_rate_argmax": success / 2, "step_spl": success - 0.1, "level": 3}
    figures |= {"frames": run.frames, "wall_seconds": seconds}
    (run.folder / "evaluation.json").write_text(json.dumps(figures))
