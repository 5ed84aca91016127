"""The settings in which two trainings differ."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.run_configs import RUN_CONFIG
from splatrl.configuration.run_files import with_absolute_paths
from splatrl.documents import read_yaml
from splatrl.values import flat

SPEED_ONLY = {"threads", "renderer.threads", "resume", "collector.cuda_graph", "optim.compile"}
SPEED_ONLY |= {"resume_changed", "allow_targets", "view"}
"""Keys of a config that do not change the results."""


def differences(asked: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """List the keys in which two configs differ, with both values, leaving out keys that cannot change results."""
    wanted, there = settings_of(asked), settings_of(found)
    return [
        f"{key}: asked for {wanted.get(key, 'nothing')}, found {there.get(key, 'nothing')}"
        for key in sorted(wanted.keys() | there.keys())
        if wanted.get(key) != there.get(key)
    ]


def differences_from_run(asked: Mapping[str, Any], folder: Path) -> list[str]:
    """List the keys in which a config differs from that of a run folder, as ``differences`` does."""
    found = read_yaml(folder / RUN_CONFIG)
    assert isinstance(found, Mapping), type(found)
    return differences(asked, {str(key): value for key, value in found.items()})


def settings_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the dotted keys of a config that can change results, with their values; paths are made absolute."""
    own = config if isinstance(config, DictConfig) else OmegaConf.create(dict(config))
    cfg = OmegaConf.to_container(with_absolute_paths(own))
    assert isinstance(cfg, dict), type(cfg)
    every = flat({str(key): value for key, value in cfg.items()})
    return {key: value for key, value in every if key not in SPEED_ONLY}
