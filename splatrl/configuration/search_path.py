"""The configs on Hydra's search path: ours, and those of plugins."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf


def conf_dir() -> Path:
    """The folder of the configs: inside the package if it is installed, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


@contextmanager
def config_loader() -> Iterator[ConfigLoader]:
    """Hydra with our configs and those of the search path's plugins; an already running Hydra is left untouched."""
    instance = GlobalHydra.instance()
    outer = instance.hydra
    instance.clear()
    try:
        with initialize_config_dir(str(conf_dir()), version_base="1.3"):
            yield instance.config_loader()
    finally:
        GlobalHydra.instance().hydra = outer  # the instance has been replaced meanwhile


def composed(overrides: Sequence[str], name: str) -> DictConfig:
    """Compose a config of what Hydra itself understands."""
    with config_loader():
        return compose(name, list(overrides))


def options(group: str) -> list[str]:
    """The options of a config group, including those of plugins; empty if there is no such group."""
    with config_loader() as loader:
        return list(loader.get_group_options(group))


def is_group(key: str) -> bool:
    """Whether an override's key names a config group, either ours or a plugin's."""
    return bool(options(key.split("@")[0]))


def group_node(group: str, option: str) -> dict[str, Any]:
    """What an option of a config group says, with references as they are written."""
    with config_loader() as loader:
        for source in loader.get_sources():
            if source.available() and source.is_config(f"{group}/{option}"):
                node = OmegaConf.to_container(source.load_config(f"{group}/{option}").config, resolve=False)
                assert isinstance(node, dict), type(node)
                return {str(key): value for key, value in node.items() if key != "defaults"}  # of the whole config
    raise AssertionError(f"{group}/{option}")
