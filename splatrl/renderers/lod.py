"""Levels of detail of a scene: a tree in which neighbours are merged, built once and kept in the scene's cache.

Every node of the tree holds at most 256 Gaussians. Those of a leaf are the scene's own. Nodes are split into compact
parts, so outliers get a part of their own. The Gaussians of an inner node stand for everything below it: the cheapest
pairs of neighbours in its two children are merged until 256 are left. Above the root of this tree are nodes with three
quarters of its Gaussians, three quarters of those, and so on down to 16, which suffice for what is small or distant. A
merged Gaussian has the total mass (opacity times area), the mean and the covariance of its members, and their
mass-weighted mean colour. For each camera the renderer descends the tree until the members of a node lie within the
tolerance of their merged means, as a mass-weighted root mean square in pixels at the node's nearest depth.
"""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from splatrl.geometry import quats_to_rotations
from splatrl.native import _core
from splatrl.renderers.base import gaussians_of, require_drawable
from splatrl.scenes.cache import Arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene

LEVELS_VERSION = 4
"""Version of the levels. Increment it when the tree or the merging changes: cached levels are then rebuilt."""


def gaussian_arrays(gaussians: Gaussians) -> dict[str, Tensor]:
    """Convert Gaussians to the arrays that the C++ core takes.

    Returns:
        ``means`` [N, 3], ``axes`` [N, 3, 3] whose columns are the axes times their standard deviations, ``opacities``
        [N] and ``sh`` [N, harmonics, 3]: float32, contiguous, in main memory.

    Raises:
        ValueError: for Gaussians that ``require_drawable`` rejects.
    """
    require_drawable(gaussians)
    fields = {
        "means": gaussians.means,
        "axes": quats_to_rotations(gaussians.quats.double()) * gaussians.scales.double().unsqueeze(-2),
        "opacities": gaussians.opacities,
        "sh": gaussians.sh,
    }
    return {name: value.detach().to("cpu", torch.float32).resolve_neg().contiguous() for name, value in fields.items()}


def levels_for(scene: Scene | Gaussians, arrays: Mapping[str, Tensor], tolerance: float) -> Arrays | None:
    """Return the levels that a renderer needs, or None if every Gaussian is drawn; a scene's are kept in its cache.

    Args:
        scene: the scene, or bare Gaussians.
        arrays: its ``gaussian_arrays``.
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.

    Raises:
        ValueError: for a tolerance that is negative or not finite.
    """
    if checked_tolerance(tolerance) == 0.0:
        return None
    if isinstance(scene, Scene):
        return cached_levels(scene, arrays)
    return build_levels(arrays, gaussians_of(scene).sh_degree)


def checked_tolerance(tolerance: float) -> float:
    """Check a tolerance in pixels, and return it unchanged.

    Raises:
        ValueError: for one that is negative or not finite.
    """
    if not 0.0 <= tolerance < float("inf"):
        raise ValueError(f"tolerance: expected a finite number of pixels, at least 0, got {tolerance}")
    return tolerance


def build_levels(arrays: Mapping[str, Tensor], degree: int) -> Arrays:
    """Build the levels of a scene; takes seconds for a million Gaussians.

    Args:
        arrays: ``means`` [N, 3], ``axes`` [N, 3, 3], ``opacities`` [N] and ``sh`` [N, harmonics, 3], float32.
        degree: degree of the spherical harmonics.

    Returns:
        The tree: ``order`` [N] and ``nodes`` [4 · nodes] uint32 (first, count, skip, leaf), ``errors`` [nodes] float32,
        metres. The M merged Gaussians, flat, float32: ``means``, ``axes``, ``opacities``, ``sh``, ``members`` (how many
        Gaussians of equal mass each stands for) and ``sums`` (the sum of their opacities).
    """
    return dict(_core.build_levels(**arrays, degree=degree))


def cached_levels(scene: Scene, arrays: Mapping[str, Tensor]) -> Arrays:
    """Return the levels of a scene, which are built once and kept in its cache.

    Colours are rounded to half floats, as they are drawn.

    Args:
        scene: the scene, which has the cache.
        arrays: the arguments of ``build_levels``, made from the scene's Gaussians.
    """

    def build() -> Arrays:
        levels = build_levels(arrays, scene.gaussians.sh_degree)
        limit = np.finfo(np.float16).max
        return levels | {"sh": levels["sh"].clip(-limit, limit).astype(np.float16)}

    levels = scene.cached("levels", {"version": LEVELS_VERSION}, build)
    return levels | {"sh": levels["sh"].astype(np.float32)}
