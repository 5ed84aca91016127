"""Sources of scenes: the generated backyard, splat files, and folders that state how their splat file lies."""

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from splatrl.files import expanded
from splatrl.scenes.blocks import BLOCKS_FILE, is_in_blocks, read_blocks, scene_place
from splatrl.scenes.description import SCENE_FILE, read_description
from splatrl.scenes.formats import read_gaussians
from splatrl.scenes.formats.limits import MAX_INFLATION
from splatrl.scenes.formats.reading import META
from splatrl.scenes.frame import checked_similarity, overridden, stated_similarity
from splatrl.scenes.nerfstudio import DATAPARSER, stands, transform_beside
from splatrl.scenes.proposals import warn_of_unknowns
from splatrl.scenes.scene import Bounds, FreeSpace, Scene, checked_bounds, robust_bounds
from splatrl.scenes.yard import backyard_gaussians
from splatrl.scenes.yard.layout import HALF_WIDTH
from splatrl.values import under_key

YARD: Bounds = ((-HALF_WIDTH, -HALF_WIDTH, 0.0), (HALF_WIDTH, HALF_WIDTH, HALF_WIDTH))
"""Bounds of the backyard, without the countryside and the sky around it."""


def backyard(seed: int = 0, clutter: int = 0, bounds: Sequence[Sequence[float]] | None = None) -> Scene:
    """Generate a sunny backyard of 6 × 6 m with a red egg to find.

    Example:
        >>> backyard().name
        'backyard'

    Args:
        seed: seed of leaves, grain, clouds and the places of the trees; at least 0.
        clutter: number of the arrangement of pots, wood pile, barrel and bench; 0 is the one to train in, and every
            other number moves them elsewhere, out of the robots' reach.
        bounds: lower and upper corner, world frame, metres; None takes those of the yard.

    Raises:
        ValueError: for empty bounds, or a ``clutter`` below 0.
    """
    corners = YARD if bounds is None else checked_bounds(bounds)
    return Scene("backyard", backyard_gaussians(seed, clutter), corners)


def read_scene(
    path: str | os.PathLike[str],
    world_from_splat: Mapping[str, Any] | Tensor | None = None,
    bounds: Sequence[Sequence[float]] | None = None,
    name: str | None = None,
    max_inflation: float = MAX_INFLATION,
) -> Scene:
    """Read a scene from a splat file or from a folder.

    A folder holds the splat file and a ``scene.yaml`` with the keys ``splat`` (the file's name), ``name``,
    ``world_from_splat`` and ``bounds``, and those of ``PROPOSALS``, which propose training settings. Arguments override
    its values, key by key: those of the transform too, which may be stated in the other form than it is typed. A folder
    that states ``metric: false``, or whose capture does not know how far up or the scale is off, causes a warning.

    A folder with a ``blocks.yaml`` and no ``scene.yaml`` is a ``BlockScene``, whose splat files are read only when they
    are needed.

    Example:
        >>> read_scene("kitchen.spz", world_from_splat={"axes": ["x", "-z", "y"]})  # doctest: +SKIP

    Args:
        path: a splat file, a folder, or the ``scene.yaml`` or ``blocks.yaml`` of a folder.
        world_from_splat: arguments of ``similarity`` by name, where None stands for the default, or a 4×4 tensor.
            Without it, the frame comes from nerfstudio's ``dataparser_transforms.json`` if there is one beside the
            file; otherwise splat coordinates are world metres.
        bounds: lower and upper corner, world frame, metres; by default those of the opaque Gaussians.
        name: name of the scene; by default that of the file or folder.
        max_inflation: as in ``read_gaussians``.

    Raises:
        FileNotFoundError: if there is no such file or folder.
        ValueError: for a damaged file, unknown keys, a frame that is not a similarity, or empty bounds; names the
            ``scene.yaml`` if that states them.
    """
    splat = scene_place(expanded(path))
    if not splat.exists():
        raise FileNotFoundError(f"{splat}: expected a splat file or a scene's folder, found none")
    if is_in_blocks(splat):
        if _says_something(world_from_splat):
            raise ValueError(
                f"world_from_splat: expected none, since {splat / BLOCKS_FILE} states where each block lies"
            )
        return read_blocks(splat, None if bounds is None else checked_bounds(bounds), name, max_inflation)
    stated: dict[str, Any] = {}
    splat = source = splat_file(splat)
    fallback, free = splat_name(splat), None
    if splat.is_dir():
        stated, fallback = read_description(splat), splat.resolve().name
        warn_of_unknowns(splat, stated)
        source = splat / SCENE_FILE
        free = None if _says_something(world_from_splat) else FreeSpace.stated(source, stated)
        splat = splat / stated["splat"]
    transform = _transform(source, stated.get("world_from_splat") or {}, world_from_splat)
    if bounds is not None:
        corners: Bounds | None = checked_bounds(bounds)
    else:
        with under_key(str(source)):
            corners = checked_bounds(stated["bounds"]) if "bounds" in stated else None
    if transform is None:
        transform = transform_beside(splat)
        if transform is not None and not stands(transform):
            warnings.warn(
                f"{splat}: {DATAPARSER} places it in the frame of its cameras, which is not z-up; find its orientation "
                "with splatrl-scene, or set world_from_splat",
                stacklevel=2,
            )
    gaussians = read_gaussians(splat, max_inflation, transform)
    return Scene(
        name=name or stated.get("name", fallback),
        gaussians=gaussians,
        bounds=corners or robust_bounds(gaussians),
        free=free,
    )


def splat_file(path: Path) -> Path:
    """Return the meta.json of an unpacked SOG in a folder without ``scene.yaml``, and any other path unchanged."""
    unpacked = (path / META).is_file() and not (path / SCENE_FILE).is_file()
    return path / META if unpacked else path


def splat_name(splat: Path) -> str:
    """Return the name of a scene without a description: that of its splat file, or of the folder of an unpacked SOG."""
    return splat.resolve().parent.name if splat.name == META else splat.stem


def _says_something(given: Mapping[str, Any] | Tensor | None) -> bool:
    return isinstance(given, Tensor) or any(value is not None for value in (given or {}).values())


def _transform(source: Path, own: Mapping[str, Any], given: Mapping[str, Any] | Tensor | None) -> Tensor | None:
    """Return the transform that a file states, overridden by an argument; None if neither states anything."""
    if isinstance(given, Tensor):
        return checked_similarity(given)
    stated_similarity(given)  # its errors are not those of the file
    with under_key(str(source)):
        return overridden(own, given or {})
