"""Scenes chosen on the command line by name, path or seed, as overrides in Hydra's grammar.

``scene_files``, which reads scenes, is imported only where it is needed, since it imports PyTorch, which takes a
second. Reporting a typing mistake or printing ``--help`` needs neither.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splatrl.configuration.grammar import bare, last_typed, quoted, unquoted
from splatrl.configuration.search_path import group_choices, group_node, options
from splatrl.values import flat, require_number

SWEEP = {"-m", "--multirun"}
"""Options that ask Hydra for a sweep."""
LISTED = re.compile(r"""(?:^|,)('[^']*'(?=,|$)|"[^"]*"(?=,|$)|[^,]*)""")
"""One of the scenes of a sweep; those whose paths contain commas are quoted."""
ONE_SCENE = {"view", "record"}
"""Commands that take a single scene."""
SEEDED = re.compile(r"(\w+):(\d+)")
"""A scene's name with a seed, such as yard:3."""


def with_scene_chosen(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Do the part of ``with_scene_paths`` that takes no time: rewrite ``scene=`` and choose the renderer of blocks."""
    result = list[str]()
    sweeps = is_sweep(overrides, name)
    for override in overrides:
        key, typed, value = override.partition("=")
        result += _choosing(value, sweeps) if key == "scene" and typed else [override]
    if name in ONE_SCENE and (several := {"scene=many", "scene=yards"}.intersection(result)):
        raise ValueError(f"scene: expected one scene for this command, got {several.pop()}; type one of its scenes")
    if "scene=yards" in result and not sweeps:
        yard_seeds(result)  # refuses what is no number
    chosen = any(override.startswith("renderer=") for override in overrides)
    return [*result, "renderer=blocks"] if not (sweeps or chosen) and _any_in_blocks(overrides, result) else result


def is_sweep(overrides: Sequence[str], name: str) -> bool:
    """Whether a command line asks for a sweep of trainings."""
    return name == "train" and bool(SWEEP.intersection(overrides))


def _choosing(value: str, sweeps: bool) -> list[str]:
    """Return the overrides that stand for ``scene=value``, the group first.

    Args:
        value: the scene as it was typed, or in a sweep several.
        sweeps: whether the command line asks for a sweep of trainings.

    Raises:
        ValueError: as in ``with_scene_paths``.
    """
    path = bare(value)
    if path in options("scene"):
        return [f"scene={path}"]  # without any quotes
    if is_path(path):
        return _files([path])
    if sweeps and all(map(is_path, several := [bare(one) for one in LISTED.findall(value)])):
        return _files(several)
    if sweeps and (seeds := _seeds(value)):
        return ["scene=yard", f"scene.seed={','.join(seeds)}"]
    if SEEDED.fullmatch(path):
        return chosen_by(path, "scene")
    if path.startswith("["):
        raise ValueError(f"scene: expected one scene, got {path}; type scene=many 'scene.paths={path}'")
    if Path(path).suffix and "," not in path:
        raise ValueError(f"scene: expected one of {', '.join(options('scene'))}, or an existing path, got {path}")
    return [f"scene={value}"]


def _seeds(value: str) -> list[str]:
    """Return the seeds in a list of yards such as yard:1,yard:2; empty if it is not one."""
    yards = [SEEDED.fullmatch(bare(one)) for one in value.split(",")]
    return [yard[2] for yard in yards if yard] if all(yard and yard[1] == "yard" for yard in yards) else []


def is_path(text: str) -> bool:
    """Whether a scene was typed as the path of something that exists, rather than as the name of a config."""
    return bool(text) and text not in options("scene") and Path(text).exists()


def _files(paths: Sequence[str]) -> list[str]:
    """Return the overrides that choose a scene, or in a sweep several, by existing paths."""
    return ["scene=file", f"scene.path={','.join(quoted(path_of_scene(path)) for path in paths)}"]


def path_of_scene(typed: str) -> str:
    """Return the path of a scene as it was typed, or its folder if ``scene.yaml`` or ``blocks.yaml`` was typed."""
    from splatrl.configuration.scene_files import found_scene

    return found_scene(typed)


def _any_in_blocks(overrides: Sequence[str], chosen: Sequence[str]) -> bool:
    """Whether the scene, or one of several, is rendered in blocks.

    Args:
        overrides: overrides as they were typed.
        chosen: the same with ``scene=`` rewritten.
    """
    if "scene=many" in chosen:
        return any(_in_blocks(str(unquoted(one))) for one in typed_paths(chosen))
    typed = [bare(override.partition("=")[2]) for override in overrides if override.startswith("scene=")]
    return any(_in_blocks(path) for path in typed if is_path(path))


def typed_paths(overrides: Sequence[str]) -> list[Any]:
    """Return the list that was typed for ``scene.paths``."""
    paths = last_typed(overrides, "scene.paths", [])
    if not isinstance(paths, list):
        raise ValueError(f"scene.paths: expected a list such as [garden/,yard:3], got {paths}")
    return paths


def _in_blocks(text: str) -> bool:
    """Whether a scene is rendered in blocks: a folder of blocks, or a config that chooses them."""
    config = text.partition(":")[0]
    if config in options("scene"):
        return group_choices("scene", config).get("renderer") == "blocks"
    from splatrl.configuration.scene_files import found_scene, is_in_blocks

    return is_in_blocks(Path(found_scene(text)))


def yard_seeds(overrides: Sequence[str]) -> range:
    """Return the seeds of ``scene=yards``.

    Raises:
        ValueError: for a count or a first seed that is not one whole number.
    """
    usual = group_node("scene", "yards")["scene"]
    count, first = (last_typed(overrides, f"scene.{key}", usual[key]) for key in ("count", "first"))
    require_number("scene.count", count, 1, 2**20, whole=True)
    require_number("scene.first", first, 0, 2**62, whole=True)
    return range(first, first + count)


def chosen_by(text: str, key: str = "scene.paths") -> list[str]:
    """Return the overrides that choose one scene, the group first.

    Args:
        text: the scene as it was typed: a config's name, with or without a seed, or a path.
        key: the key for which it was typed, for the message.
    """
    known, (config, _, seed) = _whole_configs(), text.partition(":")
    if config in known and seed.isdigit():
        return [f"scene={config}", f"scene.seed={seed}"]
    if text in known:
        return [f"scene={text}"]
    if not Path(text).exists():
        expected = f"one of {', '.join(known)}, one with a seed such as yard:3, or an existing path"
        raise ValueError(f"{key}: expected {expected}, got {text}")
    return ["scene=file", f"scene.path={quoted(Path(path_of_scene(text)).absolute())}"]


def _whole_configs() -> list[str]:
    """Return the scene configs that fully describe one scene, without those of several scenes or without a path."""
    nodes = {name: dict(flat(group_node("scene", name))) for name in options("scene")}
    return [name for name, node in nodes.items() if "scene._target_" in node and "???" not in node.values()]
