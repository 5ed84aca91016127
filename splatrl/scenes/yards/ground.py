"""The ground of a generated yard: lawn, gravel, slabs, bricks or bark, with a path and a terrace."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.yard.ground import Rect, within
from splatrl.scenes.yard.materials import Rng, mixed, shades, waves
from splatrl.scenes.yard.plants import grass, lawn_colors
from splatrl.scenes.yard.surfels import Array, Rectangle, Surfels, join, lathe, painted
from splatrl.scenes.yards.style import Style

NEAR = 1.9
"""Half width of the part that robots see up close, metres."""
BLADES = 560
"""Blades of grass per square metre near the robots; half as many elsewhere."""


@dataclass(frozen=True)
class Laid:
    """The layout of the ground's surfaces.

    Attributes:
        outline: outline of the yard.
        terrace: area with another surface; empty if x0 = x1.
        path: [P, 2] points along the centre line of a path, metres.
        width: width of the path, metres; 0 stands for stepping stones.
    """

    outline: Rect
    terrace: Rect
    path: Array
    width: float


def off_path(points: Array, path: Array) -> Array:
    """Return the distance of each point [N, 2 or 3] from the centre line of a path, points [P, 2]: [N] metres."""
    start, way = path[:-1], np.diff(path, axis=0)
    away = points[:, None, :2] - start
    along = np.clip((away * way).sum(-1) / (way * way).sum(-1), 0.0, 1.0)
    return np.linalg.norm(away - along[..., None] * way, axis=-1).min(1)


def kinds_at(points: Array, laid: Laid, style: Style) -> NDArray[np.str_]:
    """Return the surface of the ground at each point [N, 2 or 3]: [N] names from ``GROUNDS``."""
    kinds = np.full(len(points), style.base, dtype="<U8")
    kinds[within(points, laid.terrace)] = "slabs" if style.base != "slabs" else "bricks"
    if laid.width:
        kinds[off_path(points, laid.path) < laid.width / 2] = style.laid
    return kinds


def ground(laid: Laid, style: Style, rng: Rng) -> Surfels:
    """Build the ground inside the outline, with blades of grass where it is lawn.

    The ground consists of small overlapping surfels: large ones this close to a camera would smear across the image.
    """
    x0, y0, x1, y1 = laid.outline
    near = (max(x0, -NEAR), max(y0, -NEAR), min(x1, NEAR), min(y1, NEAR))
    parts = [] if laid.width else [stepping_stones(laid, style, rng)]
    for rect, step, blades in ((near, 0.055, BLADES), (laid.outline, 0.1, BLADES / 2)):
        low_x, low_y, high_x, high_y = rect
        whole = Rectangle((low_x, low_y, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), high_x - low_x, high_y - low_y)
        st, size = whole.cells(step)
        points = whole.points(st)
        kept = np.ones(len(st), bool) if rect == near else ~within(points, near)
        kept &= off_stones(points, laid) > 0.12
        st, points = st[kept], points[kept]
        parts.append(whole.surfels(st, 1.2 * np.asarray(size), ground_colors(points, laid, style, rng)))
        count = round(blades * (high_x - low_x) * (high_y - low_y))
        feet = np.append(rng.uniform((low_x, low_y), (high_x, high_y), (count, 2)), np.zeros((count, 1)), 1)
        grows = (kinds_at(feet, laid, style) == "lawn") & (off_stones(feet, laid) > 0.17)
        if rect != near:
            grows &= ~within(feet, near)
        if grows.any():
            parts.append(grass(feet[grows], 0.055 if rect == near else 0.085, rng, style.lawn))
    return join(parts)


def ground_colors(points: Array, laid: Laid, style: Style, rng: Rng) -> Array:
    """Return the colours of the ground at points [N, 3] on it: [N, 3] sRGB."""
    kinds = kinds_at(points, laid, style)
    noise = rng.normal(size=len(points))
    tint = rng.normal(size=(64, 64))
    colors = lawn_colors(points, rng, style.lawn) * rng.uniform(0.7, 0.95, (len(points), 1))
    colors[kinds == "gravel"] = mixed(
        (0.42, 0.40, 0.37), tuple(np.minimum(np.array(style.stone) * 1.3, 0.95)), 0.55 + 0.3 * noise
    )[kinds == "gravel"]
    brown = mixed((0.25, 0.17, 0.11), (0.52, 0.36, 0.24), 0.45 + 0.4 * noise)
    colors[kinds == "bark"] = brown[kinds == "bark"]
    for name, size, low, high in (
        ("slabs", (0.44, 0.44), style.stone, tuple(0.86 * v for v in style.stone)),
        ("bricks", (0.22, 0.11), *style.brick),
    ):
        there = kinds == name
        cell = points[there, :2] / size
        cell[:, 0] += 0.5 * (np.floor(cell[:, 1]) % 2)
        index = np.floor(cell).astype(int) % 64
        joint = ((cell - np.floor(cell)) * size).min(1) < 0.045
        share = 0.5 + 0.45 * tint[index[:, 0], index[:, 1]]
        tone = 0.06 * noise[there] - 0.34 * joint
        colors[there] = np.clip(
            mixed((low[0], low[1], low[2]), (high[0], high[1], high[2]), share) * (1 + tone)[:, None], 0, 1
        )
    return colors * (1 + 0.05 * waves(points, rng, 0.9))[:, None]


def off_stones(points: Array, laid: Laid) -> Array:
    """Return the distance from the nearest stepping stone's centre: [N, 3] -> [N] metres, infinite without stones."""
    if laid.width:
        return np.full(len(points), np.inf)
    return np.linalg.norm(points[:, None, :2] - stone_places(laid), axis=-1).min(1)


def stone_places(laid: Laid) -> Array:
    """Return the centres of stepping stones along the path, [S, 2] metres."""
    legs = np.linalg.norm(np.diff(laid.path, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(legs))
    at = np.arange(0.25, along[-1], 0.5)
    return np.stack([np.interp(at, along, laid.path[:, axis]) for axis in (0, 1)], -1)


def stepping_stones(laid: Laid, style: Style, rng: Rng) -> Surfels:
    """Build flat stones along the path."""
    parts = []
    for x, y in stone_places(laid):
        radius = rng.uniform(0.16, 0.21)
        disc = lathe((float(x), float(y), 0.016), [(radius, -0.016), (0.93 * radius, 0.0), (0.003, 0.004)], 0.034)
        tone = 0.07 * waves(disc.means, rng, 0.12) + 0.05 * rng.normal(size=len(disc)) + 0.08 * rng.normal()
        parts.append(painted(disc, shades(style.stone, tone)))
    return join(parts)
