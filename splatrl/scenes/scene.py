"""A scene: Gaussians in a metric world frame, their bounds, and cached arrays derived from them."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatrl.files import checked_name, digest_of
from splatrl.scenes.cache import Arrays, cached_arrays
from splatrl.scenes.gaussians import LARGEST, Gaussians

Point = tuple[float, float, float]
Bounds = tuple[Point, Point]
"""Lower and upper corner, world, metres."""

OPAQUE = 0.5
TRIM = 0.005  # fraction of the opaque Gaussians cut off at each end of each axis as floaters
MIDDLE, WIDENED, SURROUNDED = (0.1, 0.9), 0.25, 1 / 3
"""Quantiles of the opaque Gaussians between which a captured place mostly lies, the margin around that, and the maximum
ratio of the diagonals of the place and of everything where it has surroundings."""

CACHE_VERSION = 1
"""Part of every cache key; increase it when the arrays cached under the same settings change meaning."""


@dataclass(frozen=True)
class FreeSpace:
    """Voxels that are free although Gaussians fill them, because cameras saw through the haze there.

    Attributes:
        path: point cloud of the voxels' centres, world frame, metres.
        voxel_size: edge of a voxel, metres.
    """

    path: Path
    voxel_size: float

    @classmethod
    def stated(cls, source: Path, stated: Mapping[str, Any]) -> "FreeSpace | None":
        """Return the free space that a scene's file states; None if it states none.

        Args:
            source: the ``scene.yaml`` or ``blocks.yaml``, in the folder of the point cloud.
            stated: its keys and values; none is null.

        Raises:
            ValueError: for free space without a ``voxel_size``.
        """
        if "free" not in stated:
            return None
        if "voxel_size" not in stated:
            raise ValueError(f"{source}: free: expected voxel_size to be stated with it, got none")
        return cls(source.with_name(stated["free"]), float(stated["voxel_size"]))


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians in the world frame (right-handed, z up, metres).

    Attributes:
        name: name of the scene, used in captions and file names.
        gaussians: N Gaussians.
        bounds: lower and upper corner of the scene, metres.
        free: space that is not solid, whatever its Gaussians suggest; None if nothing is known about it.

    Raises:
        ValueError: if the name is not a valid file name.
    """

    name: str
    gaussians: Gaussians
    bounds: Bounds
    free: FreeSpace | None = None

    def __post_init__(self) -> None:
        checked_name("scene.name", self.name)

    @property
    def pieces(self) -> Sequence[Callable[[], Gaussians]]:
        """Functions that return all Gaussians piece by piece, so that the scene need not fit in memory at once."""
        return [lambda: self.gaussians]

    @property
    def extent(self) -> Bounds:
        """Lower and upper corner of what was captured, metres: the opaque Gaussians, without floaters."""
        return robust_bounds(self.gaussians)

    @property
    def surroundings(self) -> Gaussians:
        """Gaussians within and around the scene's bounds, for maps of the place."""
        return self.gaussians

    def cached(
        self, kind: str, settings: Mapping[str, Any], build: Callable[[], Arrays], most: int | None = None
    ) -> Arrays:
        """Return arrays derived from the Gaussians, built once and cached on disk.

        They are rebuilt exactly when the Gaussians, the settings or ``CACHE_VERSION`` change.

        Args:
            kind: identifier that names what the arrays are.
            settings: everything else that ``build`` depends on, in types that JSON can write.
            build: callback that builds the arrays.
            most: maximum total size of the arrays in bytes, if they are to be compressed on disk; None stores them
                uncompressed, for arrays that should load fast and would shrink little.
        """
        assert kind.isidentifier(), kind
        recipe = [CACHE_VERSION, dict(settings), self.digest]
        key = blake2b(json.dumps(recipe, sort_keys=True, default=list).encode(), digest_size=16)
        return cached_arrays(f"{kind}-{key.hexdigest()}", build, most, kind)

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

    @cached_property
    def content(self) -> str:
        """Fingerprint of what robots see and meet: the Gaussians, and the space that is known to be free."""
        if self.free is None:
            return self.digest
        known = f"{self.digest} {digest_of([self.free.path])} {self.free.voxel_size}"
        return blake2b(known.encode(), digest_size=16).hexdigest()


def content_of(scenes: Iterable[Scene]) -> str:
    """Return a fingerprint of the content of scenes, in order; that of a single scene is its own."""
    contents = [scene.content for scene in scenes]
    return contents[0] if len(contents) == 1 else blake2b(" ".join(contents).encode(), digest_size=16).hexdigest()


def robust_bounds(gaussians: Gaussians) -> Bounds:
    """Return the bounds of the opaque Gaussians, without the outermost half per cent at each end of each axis.

    A scene without opaque Gaussians is bounded by all of them.
    """
    opaque = gaussians.means[gaussians.opacities >= OPAQUE]
    means = opaque if len(opaque) else gaussians.means
    lower, upper = np.quantile(means.detach().cpu().double().numpy(), [TRIM, 1 - TRIM], axis=0).tolist()
    return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])


def captured_bounds(gaussians: Gaussians) -> Bounds:
    """Return the bounds of the place that was captured: the robust ones, without surroundings far larger than it.

    Most Gaussians of a capture show the place, and few what is around it, up to the sky. So where the box of the middle
    four fifths along each axis, widened by a quarter, is far smaller than the robust bounds, it is the place.
    """
    place = _surrounded(gaussians)
    return robust_bounds(gaussians) if place is None else place


def captured(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians within ``captured_bounds``, or all if the place has no surroundings far larger than it."""
    place = _surrounded(gaussians)
    if place is None:
        return gaussians
    lower, upper = torch.tensor(place, dtype=torch.float64, device=gaussians.means.device)
    return gaussians[((gaussians.means >= lower) & (gaussians.means <= upper)).all(1)]


def _surrounded(gaussians: Gaussians) -> Bounds | None:
    """Return the bounds of a place whose surroundings are far larger than it; None for any other."""
    means = gaussians.means[gaussians.opacities >= OPAQUE]
    if not len(means):
        return None
    robust = np.array(robust_bounds(gaussians))
    low, high = np.quantile(means.detach().cpu().double().numpy(), MIDDLE, axis=0)
    margin = WIDENED * (high - low)
    inner = np.maximum(robust[0], low - margin), np.minimum(robust[1], high + margin)
    if np.linalg.norm(inner[1] - inner[0]) >= SURROUNDED * np.linalg.norm(robust[1] - robust[0]):
        return None
    return _point(inner[0]), _point(inner[1])


def checked_bounds(corners: Sequence[Sequence[float]]) -> Bounds:
    """Check a lower and an upper corner, world frame, metres, and return them as bounds.

    Raises:
        ValueError: for anything else, for empty bounds, or for corners beyond ``LARGEST``.
    """
    plain = isinstance(corners, Sequence) and [len(c) if isinstance(c, Sequence) else 0 for c in corners] == [3, 3]
    if not plain or not all(isinstance(v, Real) and not isinstance(v, bool) for c in corners for v in c):
        raise ValueError(f"bounds: expected a lower and an upper corner of 3 numbers each, got {corners!r:.200}")
    if not all(abs(value) <= LARGEST for corner in corners for value in corner):
        raise ValueError(f"bounds: expected numbers from -{LARGEST:g} to {LARGEST:g}, got {corners!r:.200}")
    lower, upper = (_point(corner) for corner in corners)
    for axis, low, high in zip("xyz", lower, upper, strict=True):
        if not low < high:
            raise ValueError(f"bounds: expected lower below upper along {axis}, got {low} and {high}")
    return lower, upper


def _point(corner: Sequence[float]) -> Point:
    x, y, z = (float(value) for value in corner)
    return x, y, z
