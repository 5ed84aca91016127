"""Experiments as data: a question, and the trainings that answer it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

Compose = Callable[[Sequence[str]], dict[str, Any]]
"""Composes the complete config of a training from overrides."""
OPTIONAL: dict[str, None] = dict.fromkeys(("paper", "prepare", "score"))
"""Keys that an experiment's YAML may leave out, and their values then."""
EXPANDED = {"name", "folder", "runs", "left_out"}
"""Attributes of an ``Experiment`` that its YAML does not have."""


@dataclass(frozen=True)
class Arm:
    """One of the alternatives that an experiment compares.

    Attributes:
        label: the arm's name in tables and figures.
        overrides: overrides for ``splatrl-train``, including ``collector.total_frames``.
        scenes: names of the scenes in which the arm is trained.
        seeds: seeds of the trainings, one for each.
    """

    label: str
    overrides: Sequence[str]
    scenes: Sequence[str]
    seeds: Sequence[int]


@dataclass(frozen=True, eq=False)
class Run:
    """One training of an experiment.

    Attributes:
        scene: name of the scene.
        arm: key of the arm in the experiment's YAML.
        label: label of the arm.
        seed: seed of the training.
        folder: the run folder.
        overrides: overrides for ``splatrl-train``, including the seed but not the folder.
        config: the config composed from these overrides.
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
        """Frames allotted to the training."""
        return int(self.config["collector"]["total_frames"])

    @property
    def frames(self) -> int:
        """Frames that the training uses: the whole batches that fit its budget."""
        batch = int(self.config["collector"]["frames_per_batch"])
        return self.budget // batch * batch

    @property
    def has_curriculum(self) -> bool:
        """Whether the training begins with only a part of the start set."""
        return self.config["curriculum"].get("first") is not None


@dataclass(frozen=True)
class Experiment:
    """A question and the trainings that answer it.

    Attributes:
        name: name of the experiment on the command line and of its folder.
        title: headline of the report.
        question: the question that the experiment answers; None if nobody has stated it.
        paper: what the paper found about the question; None if nothing.
        frames_per_second: expected speed of one training.
        overhead: expected time per training on top of its frames, seconds.
        marks: numbers of frames at which the report gives the test success.
        threshold: test success for which the report gives the frames and minutes needed.
        folder: folder of the report and of the run folders.
        runs: all trainings, ordered by seed so that early reports cover every arm.
        left_out: a sentence for each arm that would repeat another one's trainings in a scene.
    """

    name: str
    title: str
    question: str | None
    paper: str | None
    frames_per_second: float
    overhead: float
    marks: Sequence[int]
    threshold: float
    folder: Path
    runs: tuple[Run, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Selection:
    """Selects a part of an experiment to train, and for how long; None keeps the experiment's own value.

    Attributes:
        seeds: seeds to train.
        frames: frames of each training; arms that differ from an earlier one only in theirs are left out.
        scenes: scenes in which to train; an arm skips scenes that only other arms name, and every arm takes the rest.
    """

    seeds: Sequence[int] | None = None
    frames: int | None = None
    scenes: Sequence[str] | None = None

    def of(self, arm: Arm, named: Collection[str]) -> list[str]:
        """Return the scenes in which to train an arm; ``named`` are the scenes that any arm of the experiment names."""
        if self.scenes is None:
            return list(arm.scenes)
        return [scene for scene in self.scenes if scene in arm.scenes or scene not in named]


def checked(name: str, node: Mapping[str, Any]) -> dict[str, Any]:
    """Check the content of an experiment's YAML, and return it with the values of keys that it leaves out.

    Args:
        name: name of the experiment.
        node: the content; ``arms`` has one ``Arm`` per key.

    Raises:
        ValueError: for a missing or unknown key.
    """
    where = f"experiments.{name}"
    known = _checked({**OPTIONAL, **node}, _keys(Experiment) - EXPANDED | {"arms", "prepare", "score"}, where)
    if not isinstance(known["arms"], Mapping):
        raise ValueError(f"{where}.arms: expected an arm by each key, got {known['arms']!r}")
    arms = {key: _checked(values, _keys(Arm), f"{where}.arms.{key}") for key, values in known["arms"].items()}
    for key, arm in arms.items():
        for name in ("overrides", "scenes", "seeds"):
            if not isinstance(arm[name], list):
                raise ValueError(f"{where}.arms.{key}.{name}: expected a list, got {arm[name]!r}")
    return {**known, "arms": arms}


def planned(
    name: str,
    node: Mapping[str, Any],
    scenes: Mapping[str, Sequence[str]],
    folder: Path,
    compose: Compose,
    selection: Selection | None = None,
) -> Experiment:
    """Expand an experiment's YAML node into its trainings.

    Args:
        name: name of the experiment.
        node: content of its YAML, as ``checked`` returns it.
        scenes: overrides by scene name; scenes that it lacks are skipped.
        folder: parent folder of all experiments.
        compose: composes the config of a training from its overrides.
        selection: the part of the experiment to train; None trains all of it.

    Raises:
        ValueError: for overrides that do not compose.
    """
    selection = selection or Selection()
    home = folder / name
    runs, left_out = list[tuple[int, Run]](), list[str]()
    planned_in: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    arms = {key: Arm(**values) for key, values in node["arms"].items()}
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
            others = planned_in.setdefault(scene, [])
            same = [label for label, known in others if selection.frames is not None and known == config]
            if same:
                alike = (
                    f"{scene}: {arm.label} is left out, since with {selection.frames:,} frames it is the same training"
                )
                left_out.append(f"{alike} as {same[0]}.")
                continue
            others.append((arm.label, config))
            for place, seed in enumerate(arm.seeds if selection.seeds is None else selection.seeds):
                own = (*overrides, f"seed={seed}")
                run_folder = home / f"{scene}-{key}-s{seed}"
                runs.append((place, Run(scene, key, arm.label, seed, run_folder, own, {**config, "seed": seed})))
    ordered = tuple(run for _, run in sorted(runs, key=lambda entry: entry[0]))
    texts = {key: node[key] for key in _keys(Experiment) - EXPANDED}
    return Experiment(name=name, folder=home, runs=ordered, left_out=tuple(left_out), **texts)


def _keys(kind: type[Arm] | type[Experiment]) -> set[str]:
    return {field.name for field in fields(kind)}


def _checked(node: object, keys: set[str], where: str) -> dict[str, Any]:
    if not isinstance(node, Mapping):
        raise ValueError(f"{where}: expected the keys {', '.join(sorted(keys))}, got {node!r}")
    if set(node) != keys:
        raise ValueError(f"{where}: expected the keys {', '.join(sorted(keys))}, got {', '.join(map(str, node))}")
    return dict(node)
