"""An experiment as data: what is asked, and the trainings that answer it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

Compose = Callable[[Sequence[str]], dict[str, Any]]
"""From overrides to the whole config of a training."""


@dataclass(frozen=True)
class Arm:
    """One of the things that an experiment compares.

    Attributes:
        label: its name in tables and figures.
        overrides: of ``splatrl-train``, ``collector.total_frames`` among them.
        scenes: names of where it is trained.
        seeds: one training each.
    """

    label: str
    overrides: Sequence[str]
    scenes: Sequence[str]
    seeds: Sequence[int]


@dataclass(frozen=True, eq=False)
class Run:
    """A training.

    Attributes:
        scene: name of where.
        arm: key of what it is of.
        label: of the arm.
        seed: of the training.
        folder: the run folder.
        overrides: of ``splatrl-train``, the seed's among them and the folder's not.
        config: what these overrides compose.
    """

    scene: str
    arm: str
    label: str
    seed: int
    folder: Path
    overrides: tuple[str, ...]
    config: Mapping[str, Any]

    @property
    def budget(self) -> int:
        """Frames that it is given."""
        return int(self.config["collector"]["total_frames"])

    @property
    def frames(self) -> int:
        """Frames that it trains: whole batches within its budget."""
        batch = int(self.config["collector"]["frames_per_batch"])
        return self.budget // batch * batch

    @property
    def has_curriculum(self) -> bool:
        """Whether it begins with a part of the start set."""
        return self.config["curriculum"].get("first") is not None


@dataclass(frozen=True)
class Experiment:
    """A question and the trainings that answer it.

    Attributes:
        name: as on the command line, and its folder's.
        title: headline of the report.
        question: what is asked.
        paper: what the paper got.
        frames_per_second: expected of a training.
        overhead: seconds of a training beside its frames.
        marks: frames at which the report tells the success in tests.
        threshold: success in tests whose frames the report tells.
        folder: of the report; the run folders are in it.
        runs: seed by seed, so that early reports show every arm.
    """

    name: str
    title: str
    question: str
    paper: str
    frames_per_second: float
    overhead: float
    marks: Sequence[int]
    threshold: float
    folder: Path
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class Selection:
    """What of an experiment is trained, and how long; None takes all of it.

    Attributes:
        seeds: those that are trained.
        frames: of each training.
        scenes: those that are trained in.
    """

    seeds: Sequence[int] | None = None
    frames: int | None = None
    scenes: Sequence[str] | None = None


def planned(
    name: str,
    node: Mapping[str, Any],
    scenes: Mapping[str, Sequence[str]],
    folder: Path,
    compose: Compose,
    selection: Selection | None = None,
) -> Experiment:
    """Turn the node of an experiment into its trainings.

    Args:
        name: of the experiment.
        node: what its YAML says; ``arms`` has an ``Arm`` a key.
        scenes: overrides by the name of a scene; scenes that are not there are left out.
        folder: of all experiments.
        compose: makes the config of a training.
        selection: what of it is trained.

    Raises:
        ValueError: names a key that is missing or unknown in the node, or overrides that do not compose.
    """
    selection = selection or Selection()
    home = folder / name
    runs: list[tuple[int, Run]] = []
    for key, values in node["arms"].items():
        where = f"experiments.{name}.arms.{key}"
        arm = Arm(**_checked(values, {field.name for field in fields(Arm)}, where))
        for scene in arm.scenes:
            if scene not in scenes or (selection.scenes is not None and scene not in selection.scenes):
                continue
            overrides = [*scenes[scene], *arm.overrides]
            if selection.frames is not None:
                overrides.append(f"collector.total_frames={selection.frames}")
            try:
                config = compose(overrides)
            except ValueError as error:
                raise ValueError(f"{where}: {error}") from error
            for place, seed in enumerate(arm.seeds if selection.seeds is None else selection.seeds):
                own = (*overrides, f"seed={seed}")
                run_folder = home / f"{scene}-{key}-s{seed}"
                runs.append((place, Run(scene, key, arm.label, seed, run_folder, own, {**config, "seed": seed})))
    ordered = tuple(run for _, run in sorted(runs, key=lambda entry: entry[0]))
    own_keys = {field.name for field in fields(Experiment)} - {"name", "folder", "runs"}
    known = _checked(node, own_keys | {"arms", "score"}, f"experiments.{name}")
    return Experiment(name=name, folder=home, runs=ordered, **{key: known[key] for key in own_keys})


def _checked(node: Mapping[str, Any], keys: set[str], where: str) -> dict[str, Any]:
    if set(node) != keys:
        raise ValueError(f"{where}: expected the keys {', '.join(sorted(keys))}, got {', '.join(sorted(node))}")
    return dict(node)
