"""Checks that a complete config must pass before anything is built from it."""

from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, ListConfig, OmegaConf

from splatrl.configuration.places import place_configs, place_names
from splatrl.configuration.scene_overrides import TARGETS
from splatrl.configuration.search_path import config_loader
from splatrl.configuration.targets import check_targets
from splatrl.values import flat, require_number

MOST = 2**31 - 1
WHOLE_NUMBERS = {
    "seed": (0, 2**63 - 1),
    "threads": (1, 1024),
    "env.num_envs": (1, MOST),
    "collector.frames_per_batch": (1, MOST),
    "collector.total_frames": (1, 2**53),
    "logger.test_interval": (1, 2**53),
    "logger.num_test_episodes": (1, MOST),
    "logger.test_seed": (0, 2**63 - 1),
    "checkpoint.interval": (1, 2**53),
    "evaluation.starts": (1, MOST),
    "evaluation.repeats": (1, MOST),
    "evaluation.batch_size": (1, MOST),
    "evaluation.seed": (0, 2**63 - 1),
    "starts.farthest": (0, MOST),
    "renderer.threads": (1, 1024),
}
"""Integer keys that are read in several places, and so not checked by a constructor, with their inclusive ranges."""
WORDS = {"evaluation.checkpoint": ("last", "best"), "logger.backend": ("csv", "tensorboard", "wandb")}
"""Keys that take one of a few words, checked here because a typo would otherwise only surface after the training."""
NULLABLE = ("starts.farthest", "renderer.threads")
COMMON = ("renderer", "drawing", "around_drawing", *TARGETS["step"])
"""Nodes and keys that the scenes of an env share: it draws them in one call, and the robots of all take equal steps."""
STATED = {key: name for name, keys in TARGETS.items() for key in keys}
"""Config keys, with the keys of a ``scene.yaml`` that give them their values."""
MAKES = "splatrl-scene <splat file> --out <folder> writes that file"
BY_SCENE = "or let splatrl-scene <splat file> --out <folder> find one, and type scene=<folder>"
EXAMPLES = {
    "run": "run=<run folder>",
    "robot.height": f"robot.height=0.4, metres above the floor, {BY_SCENE}",
    "landmarks.goal": f"landmarks.goal=[x,y,yaw], in metres and degrees, facing something, {BY_SCENE}",
    "landmarks.object": f"landmarks.object=[x,y,z], in metres, a free place for the object, {BY_SCENE}",
    "scene.path": "scene.path=<splat file or folder>",
}
"""Examples, shown in error messages, of what to type for required values that are often forgotten."""


def check_constructors(cfg: DictConfig) -> None:
    """Check every ``_target_`` against our search path and that of a running Hydra, which adds ``--config-dir``."""
    outer = GlobalHydra.instance().hydra
    with config_loader() as loader:
        check_targets(cfg, loader.get_sources() + ([] if outer is None else outer.config_loader.get_sources()))


def check_config(cfg: DictConfig) -> None:
    """Refuse a config with missing values, or with targets that are neither known nor allowed.

    Every config is checked here before anything is built from it; see ``check_targets``.

    Raises:
        ValueError: names the key, what was expected and what was given.
    """
    if isinstance(OmegaConf.select(cfg, "scene.places"), ListConfig) and not cfg.scene.places:
        raise ValueError("scene.paths: expected at least one scene, got none; type scene.paths=[garden/,yard:3]")
    names, places = place_names(cfg), place_configs(cfg)
    for name, place in zip(names, places, strict=True):
        check_constructors(place)
        plain = OmegaConf.to_container(place, resolve=False)
        needed = sorted(_missing(plain)) or sorted(_unset_landmarks(plain))
        if needed:
            key, there = needed[0], f" in {name}" if name else ""
            advice = f"type {EXAMPLES.get(key, key + '=...')}"
            if name and key in STATED:
                advice = f"state {STATED[key]} in its scene.yaml, since {key}=... applies to all scenes; {MAKES}"
            raise ValueError(f"{key}: expected a value{there}, got none; {advice}")
    _check_common(names, places)
    if "collector" in cfg:
        check_values(cfg)


def check_values(cfg: DictConfig) -> None:
    """Refuse values of a training's config that are out of range or not among the words that their keys take.

    Raises:
        ValueError: names the key, what was expected and what was given.
    """
    for key, (low, high) in WHOLE_NUMBERS.items():
        value = OmegaConf.select(cfg, key)
        if value is not None or key not in NULLABLE:
            require_number(key, value, low, high, whole=True)
    for key, valid in WORDS.items():
        if (value := OmegaConf.select(cfg, key)) not in valid:
            raise ValueError(f"{key}: expected one of {', '.join(valid)}, got {value}")


def _check_common(names: Sequence[str], places: Sequence[DictConfig]) -> None:
    """Refuse scenes that differ in settings that a batch shares.

    Args:
        names: names of the scenes.
        places: config of each scene.

    Raises:
        ValueError: names all settings that differ, as a ``scene.yaml`` does or by their keys, and what to type.
    """
    found: dict[str, str] = {}
    typed: list[str] = []
    for node in COMMON:
        chosen = [dict(_flat(place, node, resolve=True)) for place in places]
        written = dict(_flat(places[0], node, resolve=False))
        for key in dict.fromkeys(key for values in chosen for key in values):
            firsts: dict[str, str] = {}  # a scene for each value
            for name, values in zip(names, chosen, strict=True):
                firsts.setdefault(str(values.get(key)), name)
            if len(firsts) > 1 and str(written.get(key)) not in [f"${{{source}}}" for source in typed]:
                got = [f"{value} in {name}" for value, name in firsts.items()]
                found.setdefault(STATED.get(key, key), " and ".join(got[:3]))
                typed.append(key)
    if found:
        several = len(found) > 1
        raise ValueError(
            f"{', '.join(found)}: expected the same in all scenes, "
            f"got {', '.join(f'{name} {got}' if several else got for name, got in found.items())}; "
            f"type {' '.join(f'{key}=...' for key in typed)}"
        )


def _flat(cfg: DictConfig, key: str, resolve: bool) -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys and values of a node, or of a single value, with or without resolving interpolations."""
    node = OmegaConf.select(cfg, key)
    if isinstance(node, DictConfig):
        plain = OmegaConf.to_container(node, resolve=resolve)
        assert isinstance(plain, dict), type(plain)
        yield from flat({str(name): value for name, value in plain.items()}, key)
    elif node is not None:
        yield key, node


def _missing(node: Any, place: str = "") -> Iterator[str]:
    """Yield the dotted keys whose value is still ``???`` and therefore has to be given."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        where = f"{place}.{key}" if place else str(key)
        if value == "???":
            yield where
        yield from _missing(value, where)


def _unset_landmarks(plain: Any) -> list[str]:
    """Return the keys of landmarks that are null although the task refers to them."""
    said = str(plain.get("task"))
    names = [f"landmarks.{key}" for key, value in (plain.get("landmarks") or {}).items() if value is None]
    return [name for name in names if f"${{{name}}}" in said]
