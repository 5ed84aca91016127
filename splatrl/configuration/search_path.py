"""Configs on Hydra's search path: splatrl's own and those of plugins."""

import functools
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override, OverrideType
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.grammar import overrides_parser


def conf_dir() -> Path:
    """Return the folder of the configs: inside the package if it is installed, beside it in a checkout."""
    package = Path(__file__).parents[1]
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


@contextmanager
def config_loader() -> Iterator[ConfigLoader]:
    """Provide Hydra's loader for our configs and those of plugins; a Hydra that already runs is left untouched."""
    instance = GlobalHydra.instance()
    outer = instance.hydra
    instance.clear()
    try:
        with initialize_config_dir(str(conf_dir()), version_base="1.3"):
            yield instance.config_loader()
    finally:
        GlobalHydra.instance().hydra = outer  # the instance has been replaced meanwhile


def composed(overrides: Sequence[str], name: str) -> DictConfig:
    """Compose a config from overrides in Hydra's own grammar.

    Composing takes Hydra a tenth of a second, so each combination of group choices is composed once per process, and
    single values are set in a copy of the result, just as Hydra would set them.

    Raises:
        HydraException: for overrides that do not fit the configs.
    """
    parsed = overrides_parser().parse_overrides(list(overrides))
    if all(map(_is_change, parsed)):
        cfg: DictConfig = pickle.loads(_chosen(name, *(str(one.input_line) for one in parsed if _is_choice(one))))
        try:
            for value in parsed:
                if not _is_choice(value):
                    OmegaConf.update(cfg, value.key_or_group, value.value())
            return cfg
        except OmegaConfBaseException:
            pass  # Hydra reports what is wrong
    with config_loader():
        return compose(name, list(overrides))


def _is_choice(override: Override) -> bool:
    return is_group(override.key_or_group)


def _is_change(override: Override) -> bool:
    """Whether an override chooses from a group, or sets an existing key to a value that is not a dictionary."""
    if override.type != OverrideType.CHANGE or override.is_sweep_override() or isinstance(override.value(), dict):
        return False
    return override.package is None or _is_choice(override)


@functools.cache
def _chosen(name: str, *choices: str) -> bytes:
    """Compose a config from group choices alone, and pickle it, since unpickling is the fastest way to copy it."""
    with config_loader():
        return pickle.dumps(compose(name, list(choices)))


@functools.cache
def options(group: str) -> tuple[str, ...]:
    """Return the options of a config group, including those of plugins; empty if there is no such group."""
    if group.startswith(("/", ".")):  # a path, which Hydra would take for a group of its YAML files
        return ()
    with config_loader() as loader:
        return tuple(loader.get_group_options(group))


def is_group(key: str) -> bool:
    """Whether an override's key names a config group, ours or a plugin's."""
    return bool(options(key.split("@")[0]))


def choice_keys(name: str, overrides: Sequence[str]) -> list[str]:
    """Return the keys under which a config chooses from groups, such as ``task`` or ``motion@task.motion``.

    Args:
        name: name of the root config.
        overrides: choices in Hydra's grammar, on which others depend.

    Raises:
        HydraException: for choices that do not fit the configs.
    """
    with config_loader() as loader:
        return list(map(str, loader.compute_defaults_list(name, list(overrides), RunMode.RUN).overrides.known_choices))


def group_node(group: str, option: str) -> dict[str, Any]:
    """Return the content of a group's option without its defaults list, with interpolations unresolved."""
    return {key: value for key, value in _group_config(group, option).items() if key != "defaults"}


def group_choices(group: str, option: str) -> dict[str, str]:
    """Return what an option of a config group chooses in other groups, such as a renderer."""
    defaults = _group_config(group, option).get("defaults", [])
    chosen = (next(iter(one.items())) for one in defaults if isinstance(one, dict))
    return {key.removeprefix("override").strip(" /"): value for key, value in chosen}


@functools.cache
def _group_config(group: str, option: str) -> dict[str, Any]:
    with config_loader() as loader:
        for source in loader.get_sources():
            if source.is_config(f"{group}/{option}"):
                node = OmegaConf.to_container(source.load_config(f"{group}/{option}").config, resolve=False)
                assert isinstance(node, dict), type(node)
                return {str(key): value for key, value in node.items()}
    raise AssertionError(f"{group}/{option}")
