"""An experiment as data: a question, and the trainings that answer it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

Compose = Callable[[Sequence[str]], dict[str, Any]]
"""Maps overrides to the whole config of a training."""


@dataclass(frozen=True)
class Arm:
    """One of the alternatives that an experiment compares.

    Attributes:
        label: its name in tables and figures.
        overrides: overrides for ``splatrl-train``, including ``collector.total_frames``.
        scenes: names of the scenes in which it is trained.
        seeds: seeds, with one training each.
    """

    label: str
    overrides: Sequence[str]
    scenes: Sequence[str]
    seeds: Sequence[int]


@dataclass(frozen=True, eq=False)
class Run:
    """One training.

    Attributes:
        scene: name of the scene.
        arm: key of the arm.
        label: label of the arm.
        seed: seed of the training.
        folder: the run folder.
        overrides: overrides for ``splatrl-train``, including the seed but not the folder.
        config: the config that these overrides compose.
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
        """Frames that the training is given."""
        return int(self.config["collector"]["total_frames"])

    @property
    def frames(self) -> int:
        """Frames that the training uses: whole batches within its budget."""
        batch = int(self.config["collector"]["frames_per_batch"])
        return self.budget // batch * batch

    @property
    def has_curriculum(self) -> bool:
        """Whether the training begins with only part of the start set."""
        return self.config["curriculum"].get("first") is not None


@dataclass(frozen=True)
class Experiment:
    """A question and the trainings that answer it.

    Attributes:
        name: its name on the command line and of its folder.
        title: headline of the report.
        question: the question that the experiment answers.
        paper: what the paper found.
        frames_per_second: expected speed of a training.
        overhead: expected time of a training besides its frames, seconds.
        marks: numbers of frames at which the report gives the success in tests.
        threshold: success in tests for which the report gives the frames needed.
        folder: folder of the report and of the run folders.
        runs: all trainings, ordered by seed so that early reports show every arm.
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
    """Which part of an experiment is trained, and for how long; None keeps what the experiment says.

    Attributes:
        seeds: seeds to train.
        frames: frames of each training.
        scenes: scenes in which to train; those that no arm names are taken in place of an arm's own.
    """

    seeds: Sequence[int] | None = None
    frames: int | None = None
    scenes: Sequence[str] | None = None

    def of(self, arm: Arm, named: Collection[str]) -> list[str]:
        """The scenes of an arm, if all arms together name these."""
        if self.scenes is None:
            return list(arm.scenes)
        return [scene for scene in self.scenes if scene in arm.scenes or scene not in named]


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
        name: name of the experiment.
        node: content of its YAML; ``arms`` has one ``Arm`` per key.
        scenes: overrides by scene name; arms skip scenes that are not in it.
        folder: folder of all experiments.
        compose: composes the config of a training.
        selection: which part of the experiment is trained.

    Raises:
        ValueError: for a missing or unknown key in the node, or overrides that do not compose.
    """
    selection = selection or Selection()
    home = folder / name
    runs: list[tuple[int, Run]] = []
    arms = {}
    for key, values in node["arms"].items():
        arms[key] = Arm(**_checked(values, {field.name for field in fields(Arm)}, f"experiments.{name}.arms.{key}"))
    named = {scene for arm in arms.values() for scene in arm.scenes}
    for key, arm in arms.items():
        where = f"experiments.{name}.arms.{key}"
        for scene in selection.of(arm, named):
            if scene not in scenes:
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
    known = _checked(node, own_keys | {"arms", "prepare", "score"}, f"experiments.{name}")
    return Experiment(name=name, folder=home, runs=ordered, **{key: known[key] for key in own_keys})


def _checked(node: Mapping[str, Any], keys: set[str], where: str) -> dict[str, Any]:
    if set(node) != keys:
        raise ValueError(f"{where}: expected the keys {', '.join(sorted(keys))}, got {', '.join(sorted(node))}")
    return dict(node)
