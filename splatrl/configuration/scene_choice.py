"""Scenes chosen on the command line by name, path or seed, and the settings they propose for training.

``scene_files``, which reads scenes, is imported only where it is needed, since it imports PyTorch, which takes a
second. Reporting a typing mistake or printing ``--help`` needs neither.
"""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.grammar import bare, last_typed, nested, overrides_parser, quoted, readable, unquoted
from splatrl.configuration.scene_overrides import scene_overrides
from splatrl.configuration.search_path import composed, group_choices, group_node, is_group, options
from splatrl.files import expanded
from splatrl.values import flat, require_number

SWEEP = {"-m", "--multirun"}
"""Options that ask Hydra for a sweep."""
LISTED = re.compile(r"""(?:^|,)('[^']*'(?=,|$)|"[^"]*"(?=,|$)|[^,]*)""")
"""One of the scenes of a sweep; those whose paths contain commas are quoted."""
SEEDED = re.compile(r"(\w+):(\d+)")
"""A scene's name with a seed, such as yard:3."""


def load_config(overrides: Sequence[str] = (), name: str = "train") -> DictConfig:
    """Compose a config as the command line would.

    Args:
        overrides: overrides in Hydra's grammar, such as ``task=fps`` or ``task.max_steps=100``; ``scene=`` also takes a
            path.
        name: name of the root config.

    Raises:
        ValueError: for anything but a list of overrides, or for some that do not fit the configs, in the words of the
            command line.
        HydraException: for overrides that fit no config, and that the command line leaves to Hydra.
    """
    check_texts(overrides)
    words = [readable(override) for override in overrides]
    try:
        return composed(with_scene_paths(words, name), name)
    except HydraException as error:
        refused = error
    from splatrl.configuration.command_line import check_words  # which imports this module

    check_words(name, words)
    raise refused


def check_texts(overrides: Sequence[str]) -> None:
    """Refuse anything but a list of texts, such as a single override, with a ValueError."""
    several = isinstance(overrides, Sequence) and not isinstance(overrides, str)
    if not several or not all(isinstance(one, str) for one in overrides):
        raise ValueError(f"overrides: expected a list of texts such as ['task=fps'], got {overrides!r:.80}")


def job_config(cfg: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the config of one job of a sweep, with the proposals of the job's own scene.

    Args:
        cfg: the job's config as Hydra composed it.
        overrides: the job's overrides.
    """
    if not {"scene=file", "scene=yard", "scene=yards", "scene=many"}.intersection(overrides):
        return cfg
    if not GlobalHydra.instance().is_initialized():
        return load_job(overrides)
    hydra = HydraConfig.get()  # it also searches what --config-dir, --config-name and hydra.searchpath name
    search = [override for override in hydra.overrides.hydra if override.startswith("hydra.searchpath=")]
    words = with_scene_paths([readable(override) for override in _alone(overrides)])
    return compose(hydra.job.config_name, [*search, *words])


def load_job(overrides: Sequence[str]) -> DictConfig:
    """Compose the config of a training from its overrides, whether it was a job of a sweep or not.

    Args:
        overrides: the overrides that Hydra recorded; those of a job of a sweep lack what its scene proposed.
    """
    return load_config(_alone(overrides))


def _alone(overrides: Sequence[str]) -> list[str]:
    """Return the overrides of a job of a sweep as they would be typed for one training: a path after ``scene=``."""
    paths = [override for override in overrides if override.startswith("scene.path=")]
    path = expanded(str(last_typed(paths, "scene.path", ""))).absolute()  # not the name of a config
    if "scene=file" not in overrides or not paths or not path.exists():
        return list(overrides)
    return [*(override for override in overrides if override not in ("scene=file", *paths)), f"scene={path}"]


def with_scene_paths(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Rewrite a path after ``scene=`` as ``scene=file scene.path=...``, and add what the scene proposes.

    In a sweep of trainings nothing is added, since a file may sweep over scenes too: each job adds the proposals of
    its own scene (``job_config``).

    The name of a scene's config takes precedence over a file of the same name in the working directory. The proposals
    of a folder's ``scene.yaml`` come before all other overrides, so that anything typed takes precedence over them.

    Args:
        overrides: overrides in Hydra's grammar.
        name: name of the root config.

    Raises:
        ValueError: for a value that looks like a path but does not exist, or for an invalid ``scene.yaml``.
    """
    return with_proposals(with_scene_chosen(overrides, name), name)


def with_scene_chosen(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Do the part of ``with_scene_paths`` that takes no time: rewrite ``scene=`` and choose the renderer of blocks."""
    result = list[str]()
    sweeps = _sweeps(overrides, name)
    for override in overrides:
        key, typed, value = override.partition("=")
        result += _choosing(value, sweeps) if key == "scene" and typed else [override]
    if "scene=yards" in result and not sweeps:
        _yard_seeds(result)  # refuses what is no number
    chosen = any(override.startswith("renderer=") for override in overrides)
    return [*result, "renderer=blocks"] if not (sweeps or chosen) and _any_in_blocks(overrides, result) else result


def with_proposals(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Do the rest of ``with_scene_paths``: add what the scene proposes, for which yards may have to be generated."""
    if _sweeps(overrides, name):
        return list(overrides)
    return [*_proposals(overrides, name), *overrides, *_places(overrides, name)]


def _sweeps(overrides: Sequence[str], name: str) -> bool:
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
        return _chosen(path, "scene")
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
        return any(_in_blocks(str(unquoted(one))) for one in _paths(chosen))
    typed = [bare(override.partition("=")[2]) for override in overrides if override.startswith("scene=")]
    return any(_in_blocks(path) for path in typed if is_path(path))


def _places(overrides: Sequence[str], name: str) -> list[str]:
    """Return the override of ``scene.places`` for ``scene=yards``, or for the list of ``scene=many``; else nothing.

    Each scene is a folder, a splat file, the name of a scene's config, or that name with a seed: ``yard:3``. Values
    typed on the command line hold in all scenes and take precedence over a scene's own.

    Raises:
        ValueError: for a name that is neither a config nor a path.
    """
    if "scene=yards" in overrides:
        paths = _yard_paths(overrides)
    elif "scene=many" in overrides:
        paths = _paths(overrides)
    else:
        return []
    typed = {override.partition("=")[0] for override in overrides}
    others = [override for override in overrides if not override.startswith(("scene=", "scene."))]
    places = []
    for path in paths:
        text = str(unquoted(path))
        chosen = _chosen(text)
        place = dict(flat(group_node("scene", chosen[0].partition("=")[2])))
        for override in [*chosen[1:], *_proposals([*others, *chosen], name)]:
            parsed = overrides_parser().parse_override(override)
            place[parsed.key_or_group] = unquoted(parsed.value())
        places.append({key: value for key, value in place.items() if key not in typed})
    return [f"scene.places=[{','.join(nested(place) for place in places)}]"] if places else []


def _paths(overrides: Sequence[str]) -> list[Any]:
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


def _yard_paths(overrides: Sequence[str]) -> list[str]:
    """Expand ``scene=yards`` into entries of ``scene.paths``; yards not in the cache are generated in parallel."""
    from splatrl.configuration.scene_files import make_yards

    seeds = _yard_seeds(overrides)
    make_yards(seeds)
    return [f"yard:{seed}" for seed in seeds]


def _yard_seeds(overrides: Sequence[str]) -> range:
    """Return the seeds of ``scene=yards``.

    Raises:
        ValueError: for a count or a first seed that is not one whole number.
    """
    usual = group_node("scene", "yards")["scene"]
    count, first = (last_typed(overrides, f"scene.{key}", usual[key]) for key in ("count", "first"))
    require_number("scene.count", count, 1, 2**20, whole=True)
    require_number("scene.first", first, 0, 2**62, whole=True)
    return range(first, first + count)


def _chosen(text: str, key: str = "scene.paths") -> list[str]:
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


def without_proposals(overrides: Sequence[str], name: str) -> list[str]:
    """Return the overrides of a command line without what its scene proposed, which stands before all others."""
    try:
        proposed = _proposals(overrides, name)
    except (OSError, ValueError):  # the scene has gone
        return list(overrides)
    begins = list(overrides[: len(proposed)]) == proposed
    return list(overrides[len(proposed) if begins else 0 :])


def _proposals(overrides: Sequence[str], name: str) -> list[str]:
    """Return, as overrides, what the scene's folder, or metadata beside its file, proposes for the chosen task."""
    try:
        if "scene=yard" in overrides:
            from splatrl.configuration.scene_files import yard_proposals

            return scene_overrides(yard_proposals(_yard_seed(overrides)), lambda key: True)
        if "scene=file" not in overrides or not any(override.startswith("scene.path=") for override in overrides):
            return []
        from splatrl.configuration.scene_files import described

        stated = described(Path(str(last_typed(overrides, "scene.path", ""))))
        configs = _choices(overrides, name) if stated else []
    except HydraException:
        return []  # Hydra will report what is wrong
    return scene_overrides(stated, lambda key: all(has_key(cfg, key) for cfg in configs))


def _yard_seed(overrides: Sequence[str]) -> int:
    """Return the seed of ``scene=yard``, which also determines its goal."""
    seeds = [override.partition("=")[2] for override in overrides if override.startswith("scene.seed=")]
    if seeds and not re.fullmatch("[0-9]{1,18}", seeds[-1]):
        raise ValueError(
            f"scene.seed: expected one whole number of at least 0, which also sets the yard's goal, got {seeds[-1]}"
        )
    return int(seeds[-1]) if seeds else 0


def has_key(cfg: DictConfig, key: str) -> bool:
    """Whether a config has a key, even one without a value."""
    parent, _, leaf = key.rpartition(".")
    node = OmegaConf.select(cfg, parent)
    return isinstance(node, DictConfig) and leaf in list(node)  # "in node" is false for keys without a value


def _choices(overrides: Sequence[str], name: str) -> list[DictConfig]:
    """Compose the configs that the overrides of groups select, one per combination of a sweep."""
    plain = [one for one in overrides if "=" in one and not one.startswith(("-", "+", "~", "hydra"))]
    groups = []
    for text, parsed in zip(plain, overrides_parser().parse_overrides(plain), strict=True):
        key = text.partition("=")[0]
        if is_group(key):
            swept = parsed.is_sweep_override()
            values = list(parsed.sweep_string_iterator()) if swept else [parsed.get_value_element_as_str()]
            groups.append([f"{key}={value}" for value in values])
    return [composed(chosen, name) for chosen in itertools.product(*groups)]
