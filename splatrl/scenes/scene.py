"""A scene: Gaussians in a metric world frame, where they are, and what has been derived from them."""

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor
from yaml import YAMLError

from splatrl.scenes.backyard import backyard
from splatrl.scenes.backyard.layout import HALF_WIDTH
from splatrl.scenes.cache import Arrays, cached_arrays
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.frame import checked_similarity, similarity
from splatrl.scenes.gaussians import Gaussians

Point = tuple[float, float, float]
Bounds = tuple[Point, Point]
"""Lower and upper corner, world, metres."""

BACKYARD = "backyard"
BACKYARD_BOUNDS: Bounds = ((-HALF_WIDTH, -HALF_WIDTH, 0.0), (HALF_WIDTH, HALF_WIDTH, HALF_WIDTH))
"""The yard without the country and the sky around it."""

SCENE_FILE = "scene.yaml"
SCENE_KEYS = ("splat", "name", "world_from_splat", "bounds")
FRAME_KEYS = ("axes", "scale", "translation", "matrix")

OPAQUE = 0.5
TRIM = 0.005  # of the opaque Gaussians lies outside the bounds at each end of each axis: floaters

CACHE_VERSION = 1
"""Part of every cache key: raise it when what is cached under the same settings changes its meaning."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians in the world frame (right-handed, z up, metres).

    Attributes:
        name: for people: captions, file names.
        gaussians: N Gaussians.
        bounds: lower and upper corner of where the scene is, metres.
    """

    name: str
    gaussians: Gaussians
    bounds: Bounds

    def cached(
        self, kind: str, settings: Mapping[str, Any], build: Callable[[], Arrays], compressed: bool = True
    ) -> Arrays:
        """Arrays derived from the Gaussians, built once and kept on disk.

        They are built again exactly when the Gaussians, the settings or ``CACHE_VERSION`` change.

        Args:
            kind: what they are; an identifier.
            settings: all that ``build`` depends on beside the Gaussians, as JSON can write it.
            build: makes the arrays.
            compressed: on disk; False where reading should be fast and little would be saved.
        """
        assert kind.isidentifier(), kind
        recipe = [CACHE_VERSION, dict(settings), self.digest]
        key = blake2b(json.dumps(recipe, sort_keys=True, default=list).encode(), digest_size=16)
        return cached_arrays(f"{kind}-{key.hexdigest()}", build, compressed)

    @cached_property
    def digest(self) -> str:
        """Fingerprint of the Gaussians' values."""
        digest = blake2b(digest_size=16)
        g = self.gaussians
        for name in ("means", "quats", "scales", "opacities", "sh"):
            values = getattr(g, name).detach().cpu().contiguous()
            digest.update(f"{name} {values.dtype} {list(values.shape)};".encode())
            digest.update(values.numpy().data)
        return digest.hexdigest()


def robust_bounds(gaussians: Gaussians) -> Bounds:
    """Where the opaque Gaussians are, without the outermost half per cent at each end of each axis.

    A scene without opaque Gaussians is bounded by all of them.
    """
    opaque = gaussians.means[gaussians.opacities >= OPAQUE]
    means = opaque if len(opaque) else gaussians.means
    lower, upper = np.quantile(means.detach().cpu().double().numpy(), [TRIM, 1 - TRIM], axis=0)
    return _point(lower), _point(upper)


def load_scene(
    path: str | os.PathLike[str] = BACKYARD,
    world_from_splat: Mapping[str, Any] | Tensor | None = None,
    bounds: Sequence[Sequence[float]] | None = None,
    name: str | None = None,
    seed: int = 0,
    clutter: int = 0,
) -> Scene:
    """Load a scene by name, from a splat file, or from a folder.

    A folder holds the splat file and a ``scene.yaml`` with the keys ``splat`` (the file's name), ``name``,
    ``world_from_splat`` and ``bounds``; the arguments here go before it, key by key.

    Example:
        >>> load_scene().name
        'backyard'
        >>> load_scene("kitchen.spz", world_from_splat={"axes": ["x", "-z", "y"]})  # doctest: +SKIP

    Args:
        path: "backyard", which is built in; a splat file; or a folder.
        world_from_splat: the arguments of ``similarity`` by name, None standing for the default, or a 4×4 tensor.
            Without it, splat coordinates are world metres.
        bounds: lower and upper corner, world, metres; by default where the opaque Gaussians are, or the yard.
        name: by default that of the file or folder.
        seed: of the built-in scene; files have none.
        clutter: of the built-in scene: where the small things stand; 0 is where they have always stood.

    Raises:
        FileNotFoundError: where there is no such file or folder.
        ValueError: for a damaged file, unknown keys, or a frame that is not a similarity.
    """
    path = os.fspath(path)
    settings: dict[str, Any] = {}
    if path == BACKYARD:
        gaussians = backyard(seed, clutter)
        settings = {"name": BACKYARD, "bounds": BACKYARD_BOUNDS}
    else:
        splat = Path(path).expanduser()
        if splat.is_dir():
            settings = _scene_yaml(splat)
            splat = splat / settings["splat"]
            settings.setdefault("name", Path(path).expanduser().resolve().name)
        gaussians = read_gaussians(splat)
        settings.setdefault("name", splat.stem)
    transform = _transform(settings.get("world_from_splat"), world_from_splat)
    if transform is not None:
        gaussians = gaussians.transformed(transform)
    corners = bounds if bounds is not None else settings.get("bounds")
    return Scene(
        name=name or settings["name"],
        gaussians=gaussians,
        bounds=robust_bounds(gaussians) if corners is None else _checked_bounds(corners),
    )


def _scene_yaml(folder: Path) -> dict[str, Any]:
    """What a scene folder says of itself, without the keys that are null."""
    path = folder / SCENE_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a scene folder with {SCENE_FILE}, found none")
    try:
        content = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except (YAMLError, OmegaConfBaseException, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected YAML, got {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r}")
    unknown = [str(key) for key in content if key not in SCENE_KEYS]
    if unknown:
        raise ValueError(f"{path}: expected the keys {', '.join(SCENE_KEYS)}, got {', '.join(unknown)}")
    settings = {str(key): value for key, value in content.items() if value is not None}
    splat = settings.get("splat")
    if not isinstance(splat, str) or Path(splat).name != splat:
        raise ValueError(f"{path}: splat: expected the name of a file in this folder, got {splat!r}")
    if not isinstance(settings.get("name", ""), str):
        raise ValueError(f"{path}: name: expected text, got {settings['name']!r}")
    if not isinstance(settings.get("world_from_splat", {}), dict):
        raise ValueError(f"{path}: world_from_splat: expected keys and values, got {settings['world_from_splat']!r}")
    return settings


def _transform(own: Mapping[str, Any] | None, given: Mapping[str, Any] | Tensor | None) -> Tensor | None:
    """The frame that a folder states and what an argument says in its place; None where neither says anything."""
    if isinstance(given, Tensor):
        return checked_similarity(given)
    stated = {**(own or {}), **{key: value for key, value in (given or {}).items() if value is not None}}
    unknown = [str(key) for key in stated if key not in FRAME_KEYS]
    if unknown:
        raise ValueError(f"world_from_splat: expected the keys {', '.join(FRAME_KEYS)}, got {', '.join(unknown)}")
    stated = {key: value for key, value in stated.items() if value is not None}
    return similarity(**stated) if stated else None


def _checked_bounds(corners: Sequence[Sequence[float]]) -> Bounds:
    if not isinstance(corners, Sequence) or [len(c) if isinstance(c, Sequence) else 0 for c in corners] != [3, 3]:
        raise ValueError(f"bounds: expected a lower and an upper corner of 3 metres each, got {corners!r}")
    lower, upper = (_point(corner) for corner in corners)
    for axis, low, high in zip("xyz", lower, upper, strict=True):
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"bounds: expected lower below upper along {axis}, got {low} and {high}")
    return lower, upper


def _point(corner: Sequence[float]) -> Point:
    x, y, z = (float(value) for value in corner)
    return x, y, z
