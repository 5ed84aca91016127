"""The files that a config refers to by path: where they are, and where those of a run have been moved."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.grammar import written
from splatrl.configuration.known_keys import has_key
from splatrl.configuration.scene_choice import is_path, path_of_scene
from splatrl.files import expanded

PATHS = ("scene.path", "collision.occupancy.cloud", "demos", "evaluation.episodes", "task.motion.looks")
"""Keys whose strings are paths, made absolute in a run folder; ``demos`` may also be a number, which is left alone."""
NAMES_OR_PATHS = ("drawing.sprite", "transforms.sprite.sprite", "task.motion.gait", "task.motion.things", "robot.path")
"""Keys whose strings are paths or built-in names; they are paths if they are absolute or there is such a file."""
SEVERAL = "scene.paths"
"""Key of the list of scenes from which the ``scene.places`` of a config with several scenes are derived."""
OPENED_LATER = ("demos", "evaluation.episodes")
"""Keys of files that are not needed to build a world."""


def with_absolute_paths(cfg: DictConfig) -> DictConfig:
    """Return a config with absolute paths, valid from any working directory; the same object if nothing changes."""
    given = paths_of(cfg)
    absolute = {key: str(expanded(path).absolute()) for key, path in given.items()}
    return with_values(cfg, {key: path for key, path in absolute.items() if path != given[key]})


def with_values(cfg: DictConfig, values: dict[str, str]) -> DictConfig:
    """Return a copy of a config with other values for some of its keys; the same object if there are none."""
    cfg = cfg.copy() if values else cfg
    for key, value in values.items():
        OmegaConf.update(cfg, key, value)
    return cfg


def paths_of(cfg: DictConfig) -> dict[str, str]:
    """Return the paths in a config by key, such as ``task.motion.things[ball]``; built-in names are left out."""
    places = OmegaConf.select(cfg, "scene.places") or ()
    several = [f"scene.places[{number}].scene.path" for number in range(len(places))]
    named = dict(_strings(cfg, NAMES_OR_PATHS))
    files = {key: path for key, path in named.items() if expanded(path).is_absolute() or expanded(path).is_file()}
    return dict(_strings(cfg, (*PATHS, *several))) | files


def _strings(cfg: DictConfig, keys: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the strings at keys of a config and in the nodes there, with their keys."""
    for key in keys:
        value = OmegaConf.select(cfg, key)
        within = {f"{key}[{name!s}]": value[name] for name in value} if isinstance(value, DictConfig) else {key: value}
        yield from ((place, text) for place, text in within.items() if isinstance(text, str))


def check_files(cfg: DictConfig) -> None:
    """Refuse a config with a file that is not there; the message says how to tell where it is.

    Raises:
        FileNotFoundError: names the key and the path.
    """
    for key, path in paths_of(cfg).items():
        if key not in OPENED_LATER and not expanded(path).exists():
            several = key.startswith("scene.places[")
            typed = f"{SEVERAL}=[...] anew, with all scenes" if several else f"{typed_key(key)}=..."
            raise FileNotFoundError(f"{path}: expected a file or a folder, found none; if it has moved, type {typed}")


def typed_key(key: str) -> str:
    """Return one of the keys of ``paths_of`` as it is typed, such as ``task.motion.things.ball``."""
    return key.replace("[", ".").replace("]", "")


def may_name_file(cfg: DictConfig, key: str) -> bool:
    """Whether the value of one of a config's keys says where a file is, or for ``scene.paths`` where its scenes are."""
    known = {*PATHS, *NAMES_OR_PATHS, SEVERAL}
    single = not isinstance(OmegaConf.select(cfg, key), DictConfig) if has_key(cfg, key) else False
    return single and not known.isdisjoint({key, key.rpartition(".")[0]})


def set_value(cfg: DictConfig, key: str, value: object) -> None:
    """Set a value of a run's config; ``scene.paths`` also sets where the scenes of ``scene.places`` are now.

    Raises:
        ValueError: for ``scene.paths`` that do not name the run's own scenes in their order.
    """
    if key == SEVERAL and cfg.scene.get("places"):
        _move_scenes(cfg, value)
    OmegaConf.update(cfg, key, value)


def _move_scenes(cfg: DictConfig, names: object) -> None:
    places, before = cfg.scene.places, list(cfg.scene.paths)
    own, got = written(list(map(str, before))), written(names)
    told = f"{SEVERAL}: expected the run's own scenes, {own}, with new paths of those that have moved, got {got}"
    if not isinstance(names, list) or len(names) != len(places):
        raise ValueError(told)
    for place, old, new in zip(places, before, map(str, names), strict=True):
        if "path" in place.scene and is_path(new):
            place.scene.path = str(Path(path_of_scene(new)).absolute())
        elif new != old or "path" in place.scene:
            raise ValueError(told)
