"""Reads the config of a run whose files have been moved, or moves it to a place in which it was not trained."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.checking import check_constructors
from splatrl.configuration.grammar import overrides_parser, quoted, written
from splatrl.configuration.known_keys import has_key
from splatrl.configuration.loading import load_config, load_job
from splatrl.configuration.places import place_configs
from splatrl.configuration.run_configs import run_config
from splatrl.configuration.run_files import (
    NAMES_OR_PATHS,
    PATHS,
    SEVERAL,
    may_name_file,
    set_value,
    with_absolute_paths,
)
from splatrl.configuration.scene_proposals import without_proposals
from splatrl.configuration.search_path import composed
from splatrl.documents import read_yaml
from splatrl.values import flat

PLACE = ("scene", "robot", "landmarks", "task", "collision", "renderer")
"""Nodes of a run's config that describe the place in which it was trained."""
TRANSFORMS = "transforms"
"""The node, and the folder of config groups, of what delays, alters or repeats; a run's own hold at any place."""
SEEN = (TRANSFORMS, "around_drawing", "drawing")
"""Nodes that the choice of a transform sets."""
OF_A_SCENE = ("scene", "landmarks", "task.motion.lower", "task.motion.upper")
"""Overrides that belong to one scene and do not carry over to another."""
OF_A_RUN = ("hydra", "resume", "resume_changed", "allow_targets", "view")
"""Overrides that belong to one run only."""
TYPED = Path(".hydra", "overrides.yaml")
"""The file in a run folder in which Hydra records the overrides that were typed."""


def placed(cfg: DictConfig, place: DictConfig) -> DictConfig:
    """Return the config of a run, moved to the place of another config; its transforms are those of the run."""
    cfg = cfg.copy()
    for key in PLACE:
        cfg[key] = place[key]
    return cfg


def config_elsewhere(folder: Path, words: Sequence[str], allow_targets: Sequence[str] = ()) -> DictConfig:
    """Return the config of a run with its files where they are now, or of another place.

    Words that say where a file of the run is, such as ``scene.path=home/``, change nothing else. With any others, the
    config is what it would be if they had been typed for the training's place.

    Args:
        folder: the run folder, which need not be trusted.
        words: overrides of the place, such as ``scene=kitchen``; choosing a scene also drops the overrides of the
            original scene's goals and bounds, and what that scene proposed. Transforms stay the run's own unless some
            are chosen, such as ``transforms/latency=none``. Settings that a resumption changed hold. Without any, the
            config is the run's own.
        allow_targets: see ``run_config``.

    Raises:
        FileNotFoundError: if another place is asked for and the run folder has no record of the overrides.
        ValueError: for overrides that the command line would refuse, or that would build what is not allowed.
    """
    own, words = _with_files(run_config(folder, allow_targets), words)
    if not words:
        return own
    path = folder / TYPED
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected the overrides typed for the training, found no such file; without it, only the new path "
            f"of a file can be typed, as in scene.path=..., got {' '.join(words)}"
        )
    typed = read_yaml(path)
    if not isinstance(typed, list) or not all(isinstance(word, str) and "${" not in word for word in typed):
        raise ValueError(f"{path}: expected a list of overrides without ${{...}} references, got {typed!r:.80}")
    given = {key: OmegaConf.select(own, key) for key in PATHS}
    paths = {key: f"{key}={quoted(value)}" for key, value in given.items() if isinstance(value, str)}  # absolute
    if scenes := _scene_paths(own):
        paths["scene.paths"] = f"scene.paths={written(scenes)}"
    typed = [paths.get(_key(word), word) for word in typed]
    changed = _changed_later(own, typed)
    elsewhere = any(word.startswith("scene=") for word in words)
    if elsewhere:
        typed = without_proposals(typed, "train")
    dropped = (*OF_A_RUN, *(OF_A_SCENE if elsewhere else ()))
    kept = [word for word in typed if not f"{_key(word)}.".startswith(tuple(f"{key}." for key in dropped))]
    there = load_config([*kept, *words])
    chosen = {_key(word) for word in words}
    for key, value in changed.items():
        if not any(f"{key}.".startswith(f"{one}.") for one in (*dropped, *chosen)) and has_key(there, key):
            OmegaConf.update(there, key, value)
    there.allow_targets = list(allow_targets)
    check_constructors(there)
    moved = placed(own, there)
    if any(key.startswith(f"{TRANSFORMS}.") for key in chosen):
        for key in SEEN:
            moved[key] = there.get(key)
    return moved


def _with_files(own: DictConfig, words: Sequence[str]) -> tuple[DictConfig, list[str]]:
    """Return a run's config with its files where some words say that they are, and the other words.

    A path beside the choice of a whole node, as in ``scene=kitchen scene.path=kitchen.spz``, is not one of the run's.
    """
    keys, others = [_key(word) for word in words], list[str]()
    for key, word in zip(keys, words, strict=True):
        within = any(key.startswith(f"{node}.") for node in keys)
        if within or word.startswith("~") or not may_name_file(own, key):
            others.append(word)
        else:
            set_value(own, key, overrides_parser().parse_override(word).value())
    return with_absolute_paths(own), others


def _scene_paths(own: DictConfig) -> list[str]:
    """Return what was typed for the scenes of a run with several, with absolute paths; empty for one with one scene."""
    names = OmegaConf.select(own, "scene.paths") or []
    places = place_configs(own) if names else []
    return [str(OmegaConf.select(place, "scene.path") or name) for place, name in zip(places, names, strict=True)]


def _changed_later(own: DictConfig, typed: Sequence[str]) -> dict[str, Any]:
    """Return the settings of a run's place that a resumption changed, by dotted key.

    Args:
        own: the config of the run.
        typed: the overrides with which the run began; those of a job of a sweep lack what its scene proposed.
    """
    try:
        then = composed(typed, "train")
        with suppress(OSError, ValueError, HydraException):  # the scene has gone
            then = load_job(typed)  # whichever Hydra app this is
        then = with_absolute_paths(then)
    except HydraException:  # typed for other configs than those of today
        return {}
    nodes = [
        cast(dict[str, Any], OmegaConf.to_container(OmegaConf.masked_copy(cfg, [*PLACE, *SEEN]))) for cfg in (then, own)
    ]
    began, now = (dict(flat(node)) for node in nodes)
    return {key: value for key, value in now.items() if key in began and value != began[key]}


def words_of_place(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split command-line overrides into those of a run's place and all others."""
    keys = {word: _key(word) for word in words if "=" in word}
    nodes = (*PLACE, TRANSFORMS)
    mine = [word for word, key in keys.items() if key.partition(".")[0] in nodes or key in NAMES_OR_PATHS]
    return mine, [word for word in words if word not in mine]


def moves_scene(words: Sequence[str]) -> bool:
    """Return whether overrides say where the scenes of a run are now, rather than choose others."""
    keys = {_key(word) for word in words}
    return "scene" not in keys and any(key == SEVERAL or key.endswith("scene.path") for key in keys)


def says_where(words: Sequence[str], key: str) -> bool:
    """Return whether overrides say where the file at a key is, as it is typed."""
    return any(_key(word) == key for word in words)


def _key(word: str) -> str:
    """Return the key of an override; for a group with a package, the package: task.motion for motion@task.motion."""
    group, _, place = word.lstrip("+~").partition("=")[0].partition("@")
    return (place or group).replace("/", ".")
