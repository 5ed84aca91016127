"""Configs of several scenes, split into one config per scene."""

from collections.abc import Sequence

from omegaconf import DictConfig, ListConfig, OmegaConf


def place_configs(cfg: DictConfig) -> list[DictConfig]:
    """Split a config into one config per scene; a config with a single scene is returned as it is.

    Each entry of ``scene.places`` holds what belongs to one scene: ``scene``, which is built, and values of other keys.
    """
    places = _listed(cfg)
    if not places:
        return [cfg]
    plain = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "scene"])
    result = []
    for place in places:
        merged = OmegaConf.merge(plain, place)
        assert isinstance(merged, DictConfig), type(merged)
        merged.allow_targets = cfg.allow_targets  # a place cannot change which packages are trusted
        result.append(merged)
    return result


def place_names(cfg: DictConfig) -> list[str]:
    """Return the name that was typed for each of a config's ``place_configs``; one empty name if there is only one."""
    places = _listed(cfg)
    if len(places) < 2:
        return [""]
    paths = cfg.scene.get("paths")
    if isinstance(paths, ListConfig) and len(paths) == len(places):
        return [str(path) for path in paths]
    return [f"yard:{place.scene.seed}" for place in places]


def _listed(cfg: DictConfig) -> Sequence[DictConfig]:
    """Return ``scene.places``; empty if there are none."""
    return (cfg.scene.get("places") if "scene" in cfg and isinstance(cfg.scene, DictConfig) else None) or ()
