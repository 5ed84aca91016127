"""Checks that a complete config must pass before anything is built from it."""

from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, ListConfig, OmegaConf

from splatrl.configuration.places import place_configs, place_names
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
COMMON = ("renderer", "drawing", "around_drawing")
"""Nodes that an env builds only once, so that they must be the same in all of its scenes."""
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
    places = place_configs(cfg)
    for name, place in zip(place_names(cfg), places, strict=True):
        check_constructors(place)
        plain = OmegaConf.to_container(place, resolve=False)
        needed = sorted(_missing(plain)) or sorted(_unset_landmarks(plain))
        if needed:
            example, there = EXAMPLES.get(needed[0], needed[0] + "=..."), f" in {name}" if name else ""
            raise ValueError(f"{needed[0]}: expected a value{there}, got none; type {example}")
    _check_common(places)
    for key, (low, high) in WHOLE_NUMBERS.items() if "collector" in cfg else ():  # only training configs
        value = OmegaConf.select(cfg, key)
        if value is not None or key not in NULLABLE:
            require_number(key, value, low, high, whole=True)
    for key, valid in WORDS.items() if "collector" in cfg else ():
        if (value := OmegaConf.select(cfg, key)) not in valid:
            raise ValueError(f"{key}: expected one of {', '.join(valid)}, got {value}")


def _check_common(places: Sequence[DictConfig]) -> None:
    """Refuse scenes whose rendering settings differ, because a batch is rendered in one call.

    Raises:
        ValueError: names the key that differs.
    """
    for node in COMMON:
        drawn = [dict(_resolved(place, node)) for place in places]
        for key in dict.fromkeys(key for values in drawn for key in values):
            got = list(dict.fromkeys(str(values.get(key)) for values in drawn))
            if len(got) > 1:
                raise ValueError(f"{key}: expected the same in all scenes, got {' and '.join(got[:3])}; type {key}=...")


def _resolved(cfg: DictConfig, key: str) -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys and values of a node, with interpolations resolved."""
    node = OmegaConf.select(cfg, key)
    plain = OmegaConf.to_container(node, resolve=True) if isinstance(node, DictConfig) else {}
    assert isinstance(plain, dict), type(plain)
    return flat({str(name): value for name, value in plain.items()}, key)


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
