"""Spreads Gaussians over each surface, and makes the backyard, once in a process: tests build the same few robots and
the same scene again and again."""

import functools
import sys

import numpy as np


def spread_once() -> None:
    """Let ``gaussians_from_mjcf``, if it is imported, remember which points it chose on the triangles of a geom."""
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
    """Let ``backyard``, if it is imported, remember its Gaussians; each call still gets a copy of its own."""
    sources = sys.modules.get("splatrl.scenes.sources")
    if sources is not None:
        remembered = functools.cache(sources.backyard_gaussians)
        sources.backyard_gaussians = lambda seed, clutter: remembered(seed, clutter).clone()
