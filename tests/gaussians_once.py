"""Caches of Gaussians on the surfaces of robots and of the backyard: in each process, tests build the same few robots
and the same scene again and again."""

import functools
import sys

import numpy as np


def spread_once() -> None:
    """Cache the points that ``gaussians_from_mjcf``, if it is imported, chooses on the triangles of each geom."""
    gaussians = sys.modules.get("splatrl.physics.gaussians")
    if gaussians is None:
        return
    spread = gaussians._spread_points

    @functools.cache
    def remembered(corners: bytes, count: int) -> tuple[np.ndarray, ...]:
        found = spread(np.frombuffer(corners).reshape(-1, 3, 3), count)
        for array in found:
            array.flags.writeable = False
        return found

    gaussians._spread_points = lambda corners, count: remembered(corners.tobytes(), count)


def backyard_once() -> None:
    """Cache the Gaussians of ``backyard``, if it is imported; each call still gets its own copy."""
    sources = sys.modules.get("splatrl.scenes.sources")
    if sources is not None:
        remembered = functools.cache(sources.backyard_gaussians)
        sources.backyard_gaussians = lambda seed, clutter: remembered(seed, clutter).clone()
