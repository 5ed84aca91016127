"""Checks which constructors a config may name, so that a run folder from an untrusted source cannot run code."""

from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from hydra.plugins.config_source import ConfigSource
from hydra.utils import get_object
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError, InterpolationToMissingValueError, OmegaConfBaseException

from splatrl.configuration.search_path import is_group

MAX_VALUES = 10_000
"""Maximum number of values in a config once its interpolations are followed; our configs have 200."""
HYDRAS_OWN = ("hydra", "schema")
"""Providers of Hydra's own configs, which are not trusted because their constructors launch jobs."""


def check_targets(cfg: DictConfig, sources: Sequence[ConfigSource]) -> None:
    """Refuse a config with a ``_target_`` that is neither known nor trusted.

    A target is known if it appears in a config on Hydra's search path: splatrl's, and those of installed plugins. It is
    trusted if a package in ``cfg.allow_targets`` defines it itself, rather than importing it from elsewhere.

    Args:
        cfg: a complete config.
        sources: the config sources on the search path.

    Raises:
        ValueError: names the key and the target; or says that interpolations in the config cannot be followed.
    """
    known = set[object]().union(*map(_standing, sources))
    trusted = [str(package) for package in cfg.get("allow_targets") or []]
    for key, target in targets(cfg):
        if target not in known and not (isinstance(target, str) and _defined_in(target, trusted)):
            raise ValueError(
                f"{key}: expected a constructor that appears in conf/, or that is defined in a package named in "
                f"allow_targets=[<package>], got {target!r}"
            )


def targets(cfg: DictConfig) -> list[tuple[str, object]]:
    """Return the key and value of every ``_target_`` in a config, following interpolations as building does.

    Raises:
        ValueError: for interpolations that are broken or circular, or that expand to more than ``MAX_VALUES`` values.
    """
    found = []
    try:
        for count, (key, value) in enumerate(_followed(cfg, "")):
            if count == MAX_VALUES:
                raise ValueError(
                    f"config: expected at most {MAX_VALUES:,} values once references are followed, got more"
                )
            if key.rpartition(".")[2] == "_target_":
                found.append((key, value))
    except (OmegaConfBaseException, RecursionError) as error:
        raise ValueError(f"config: expected references that resolve to values, got {error}") from error
    return found


def _followed(node: DictConfig | ListConfig, place: str) -> Iterator[tuple[str, object]]:
    for key in list(node) if isinstance(node, DictConfig) else range(len(node)):
        if OmegaConf.is_missing(node, key):
            continue
        where = f"{place}.{key}" if place else str(key)
        try:
            value = node[key]
        except InterpolationToMissingValueError:
            continue  # nothing can be built from it either
        except InterpolationKeyError as error:
            name = str(error).partition("'")[2].partition("'")[0]
            group = name.partition(".")[0]
            hint = f"; choose a {group}=... that has it" if is_group(group) else ""
            raise ValueError(f"{where}: expected a value for {name}, found no such key{hint}") from error
        yield where, value
        if isinstance(value, DictConfig | ListConfig):
            yield from _followed(value, where)


def _defined_in(target: str, packages: Sequence[str]) -> bool:
    def within(name: str) -> bool:
        return any(f"{name}.".startswith(f"{package}.") for package in packages)

    if not within(target):
        return False
    try:
        return within(str(getattr(get_object(target), "__module__", None)))
    except (ImportError, ValueError) as error:
        raise ValueError(f"expected {target} to be importable, got {error}") from error


_known: dict[tuple[str, str], set[object]] = {}


def _standing(source: ConfigSource) -> set[object]:
    """Return every ``_target_`` in a folder of configs; each folder is read only once."""
    place = source.provider, source.full_path()
    if source.provider in HYDRAS_OWN or (folder := _folder_of(source)) is None:
        return set()
    if place not in _known:
        _known[place] = {target for text in _texts(folder) for target in _values_of("_target_", _parsed(text))}
    return _known[place]


def _folder_of(source: ConfigSource) -> Any:
    """Return a folder of configs, on disk or in a package, which needs no ``__init__.py``; None if there is none."""
    try:
        folder = files(source.path) if source.scheme() == "pkg" else Path(source.path)
    except ModuleNotFoundError:
        return None
    return folder if folder.is_dir() else None


def _texts(folder: Any) -> Iterator[str]:
    """Yield the text of every config with a ``_target_`` in a folder on disk or in a package."""
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _texts(entry)
        elif entry.name.endswith(".yaml") and "_target_" in (text := entry.read_text(encoding="utf-8")):
            yield text


def _parsed(text: str) -> Any:
    """Parse YAML, with the C library if available, which is many times faster than Hydra's pure-Python loader."""
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def _values_of(key: str, node: Any) -> Iterator[object]:
    if isinstance(node, dict) and key in node:
        yield node[key]
    for value in node.values() if isinstance(node, dict) else node if isinstance(node, list) else []:
        yield from _values_of(key, value)
