"""Whether a key that was typed exists in a config, and which similar keys do."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import NoReturn

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.kinds import value_of
from splatrl.configuration.search_path import options

MOST_NEAR = 3  # similar keys to suggest, at most


def check_key(key: str, known: Sequence[Mapping[str, DictConfig]]) -> None:
    """Refuse a key that a config lacks.

    Args:
        key: the key.
        known: the configs that must have it; see ``compositions``.

    Raises:
        ValueError: names the key and the choices of a sweep that lack it; or, if all configs do, similar keys and those
            that are valid in its place.
    """
    for configs in known:
        without = [choice for choice, cfg in configs.items() if not has_key(cfg, key)]
        if 0 < len(without) < len(configs):
            raise ValueError(
                f"{key}: no such key with {', '.join(without)}; run that choice separately, without the key"
            )
    cfg = next(iter(known[0].values()))
    if not has_key(cfg, key):
        _refuse(key, cfg)


def has_key(cfg: DictConfig, key: str) -> bool:
    """Whether a config has a key, even one without a value."""
    parents, _, leaf = key.rpartition(".")
    node = value_of(cfg, parents) if parents else cfg
    return isinstance(node, DictConfig) and leaf in list(node)  # "in node" is false for keys without a value


def _refuse(key: str, known: DictConfig) -> NoReturn:
    *parents, leaf = key.split(".")
    node = value_of(known, ".".join(parents)) if parents else known
    keys = list(node) if isinstance(node, DictConfig) else []
    valid = [str(one) for one in keys if not str(one).startswith("_")]
    near = [".".join([*parents, match]) for match in difflib.get_close_matches(leaf, valid, 1)]
    near = near or _near_keys(leaf, known)
    near = ["scene=<the path>"] if key == "scene.path" else near
    hint = f", did you mean {' or '.join(near)}?" if near else "."
    place = ".".join(parents)
    if valid:
        known_keys = f"Valid keys {f'of {place}' if parents else 'at the top level'}: {', '.join(valid)}"
    elif options(place):
        known_keys = f"{place} is a config group with the options {', '.join(options(place))}"
    else:
        known_keys = f"{place} has no keys"
    raise ValueError(f"{key}: no such key{hint} {known_keys}")


def _near_keys(word: str, known: DictConfig) -> list[str]:
    """Return full keys whose last part resembles a word or contains it between underscores."""
    leaves = list(_leaves(OmegaConf.to_container(known, resolve=False), ""))
    names = {key.rpartition(".")[2] for key in leaves}
    near = {*difflib.get_close_matches(word, names), *(name for name in names if word in name.split("_"))}
    return sorted(key for key in leaves if key.rpartition(".")[2] in near)[:MOST_NEAR]


def _leaves(node: object, place: str) -> Iterator[str]:
    """Yield the dotted keys of all leaf values, except those such as ``_target_`` that say what to build."""
    if not isinstance(node, dict):
        yield place
        return
    for key, value in node.items():
        if not str(key).startswith("_"):
            yield from _leaves(value, f"{place}.{key}" if place else str(key))
