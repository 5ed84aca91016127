"""Settings that the chosen scene proposes for training, found in its folder or generated with it.

``scene_files``, which reads scenes, is imported only where it is needed, since it imports PyTorch, which takes a
second.
"""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from hydra.errors import HydraException
from omegaconf import DictConfig

from splatrl.configuration.grammar import last_typed, nested, overrides_parser, unquoted
from splatrl.configuration.known_keys import has_key
from splatrl.configuration.scene_choice import chosen_by, is_sweep, typed_paths, yard_seeds
from splatrl.configuration.scene_overrides import scene_overrides
from splatrl.configuration.search_path import composed, group_node, is_group
from splatrl.values import flat


def with_proposals(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Do the rest of ``with_scene_paths``: add what the scene proposes, for which yards may have to be generated."""
    if is_sweep(overrides, name):
        return list(overrides)
    return [*_proposals(overrides, name), *overrides, *_places(overrides, name)]


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
        paths = typed_paths(overrides)
    else:
        return []
    typed = {override.partition("=")[0] for override in overrides}
    others = [override for override in overrides if not override.startswith(("scene=", "scene."))]
    places = []
    for path in paths:
        text = str(unquoted(path))
        chosen = chosen_by(text)
        place = dict(flat(group_node("scene", chosen[0].partition("=")[2])))
        for override in [*chosen[1:], *_proposals([*others, *chosen], name)]:
            parsed = overrides_parser().parse_override(override)
            place[parsed.key_or_group] = unquoted(parsed.value())
        places.append({key: value for key, value in place.items() if key not in typed})
    return [f"scene.places=[{','.join(nested(place) for place in places)}]"] if places else []


def _yard_paths(overrides: Sequence[str]) -> list[str]:
    """Expand ``scene=yards`` into entries of ``scene.paths``; yards not in the cache are generated in parallel."""
    from splatrl.configuration.scene_files import make_yards

    seeds = yard_seeds(overrides)
    make_yards(seeds)
    return [f"yard:{seed}" for seed in seeds]


def _yard_seed(overrides: Sequence[str]) -> int:
    """Return the seed of ``scene=yard``, which also determines its goal."""
    seeds = [override.partition("=")[2] for override in overrides if override.startswith("scene.seed=")]
    if seeds and not re.fullmatch("[0-9]{1,18}", seeds[-1]):
        raise ValueError(
            f"scene.seed: expected one whole number of at least 0, which also sets the yard's goal, got {seeds[-1]}"
        )
    return int(seeds[-1]) if seeds else 0


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
