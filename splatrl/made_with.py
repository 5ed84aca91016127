"""The scene, settings and hardware of a training, and whether another run may resume it."""

import warnings
from collections.abc import Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration import PATHS
from splatrl.files import expanded
from splatrl.native import _core
from splatrl.values import flat

SPEED_ONLY = {"threads", "renderer.threads", "resume", "collector.cuda_graph", "optim.compile"}
SPEED_ONLY |= {"resume_changed", "allow_targets", "view"}
"""Keys of a config that do not change the results."""
FREE = ("device:", "scene.path:", "scene.name:", "logger.", "checkpoint.", "evaluation.", "collector.total_frames:")
"""Prefixes of the lines of ``differences`` that a resumed run may have; a scene is identified by its content."""


def differences(asked: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """List the keys in which two configs differ, with both values, leaving out keys that cannot change results."""
    wanted, there = _settings(asked), _settings(found)
    return [
        f"{key}: asked for {wanted.get(key, 'nothing')}, found {there.get(key, 'nothing')}"
        for key in sorted(wanted.keys() | there.keys())
        if key not in SPEED_ONLY and wanted.get(key) != there.get(key)
    ]


def made_with(cfg: DictConfig, scene_digest: str) -> dict[str, Any]:
    """Return everything that a training's results depend on, as plain values for its checkpoints.

    Args:
        cfg: config of the training.
        scene_digest: digest of the scene's Gaussians.
    """
    settings = OmegaConf.to_container(cfg)
    assert isinstance(settings, dict)
    return {"settings": settings, "scene": scene_digest, "isa": _core.isa(), "threads": cfg.threads}


def check_made_with(now: Mapping[str, Any], then: Mapping[str, Any]) -> None:
    """Refuse to resume a training that began with another scene or other settings.

    The device, the scene's location, the training's length and the settings of logging, checkpoints and evaluation may
    change. If the number of PyTorch threads or the processor's instruction set differs, a warning says that results may
    differ in their last bits.

    Args:
        now: ``made_with`` of the run that is to resume.
        then: ``made_with`` from its checkpoint; empty if there is none.

    Raises:
        ValueError: names the differences, and the setting that resumes nevertheless.
    """
    if not then:
        return
    changed = [line for line in differences(now["settings"], then["settings"]) if not line.startswith(FREE)]
    if now["scene"] != then["scene"]:
        changed.append("scene: its Gaussians differ")
    if changed:
        lines = ["resume: expected the scene and settings with which the run began, got different ones:"]
        raise ValueError(
            "\n".join(
                [*lines, *(f"  {line}" for line in changed), "to resume with them anyway, type resume_changed=true"]
            )
        )
    other = [f"{key} {now[key]} instead of {then[key]}" for key in ("isa", "threads") if now[key] != then[key]]
    if other:
        warnings.warn(f"resume: resuming with {', '.join(other)}; results may differ in the last bits", stacklevel=2)


def _settings(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the dotted keys of a config with their values, with paths made absolute."""
    return {
        key: str(expanded(value).absolute()) if key in PATHS and isinstance(value, str) else value
        for key, value in flat(config)
    }
