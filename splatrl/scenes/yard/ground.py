"""The ground: lawn, stepping stones, flower beds and the land beyond."""

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.yard.layout import HALF_WIDTH
from splatrl.scenes.yard.materials import Color, Rng, shades, waves
from splatrl.scenes.yard.plants import GREENS, grass, lawn_colors, shrub
from splatrl.scenes.yard.sky import RADIUS
from splatrl.scenes.yard.surfels import THICKNESS, Array, Rectangle, Surfels, join, lathe, painted, surfels

NEAR = 1.8
"""Half width of the part of the lawn that robots see up close, metres."""
STONES = ((-0.75, -2.45), (-0.72, -1.95), (-0.62, -1.45), (-0.55, -0.95), (-0.58, -0.45), (-0.66, 0.08), (-0.6, 0.6))
"""Centres of the stepping stones that lead from the shed's door into the yard, metres."""
FAR = (0.55, 0.62, 0.52)
"""Colour of the land at the horizon, sRGB."""
Rect = tuple[float, float, float, float]
"""Rectangle on the ground, by its lower and upper x and y: x0, y0, x1, y1, metres."""


def square(half: float) -> Rectangle:
    """Return the square on the ground around the origin with this half width."""
    return Rectangle((-half, -half, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 2 * half, 2 * half)


def within(points: Array, rect: Rect) -> NDArray[np.bool_]:
    """Return whether each point [N, 2 or 3], metres, lies in a rectangle: [N] bool."""
    x0, y0, x1, y1 = rect
    return (points[:, 0] > x0) & (points[:, 0] < x1) & (points[:, 1] > y0) & (points[:, 1] < y1)


def turf(rng: Rng) -> Surfels:
    """Build the lawn: a layer of ground without gaps, finer in the middle, and blades of grass.

    The ground consists of small overlapping surfels: large ones this close to a camera would smear across the image.
    """
    parts = []
    for half, inner, step, blades, length in ((NEAR, 0.0, 0.057, 8000, 0.055), (HALF_WIDTH, NEAR, 0.12, 3600, 0.085)):
        ground = square(half)
        st, size = ground.cells(step)
        points = ground.points(st)
        kept = (np.abs(points).max(1) > inner) & ~on_stones(points, 0.12)
        colors = lawn_colors(points[kept], rng) * rng.uniform(0.7, 0.95, (int(kept.sum()), 1))
        parts.append(ground.surfels(st[kept], 1.2 * np.asarray(size), colors))
        feet = np.append(rng.uniform(-half, half, (blades, 2)), np.zeros((blades, 1)), 1)
        parts.append(grass(feet[(np.abs(feet).max(1) > inner) & ~on_stones(feet, 0.17)], length, rng))
    return join(parts)


def on_stones(points: Array, radius: float) -> NDArray[np.bool_]:
    """Return whether each point [N, 3] is within ``radius`` metres of the centre of a stepping stone: [N] bool."""
    return (np.linalg.norm(points[:, None, :2] - np.array(STONES), axis=-1) < radius).any(1)


def stones(rng: Rng) -> Surfels:
    """Build flat grey stepping stones in the grass."""
    parts = []
    for x, y in STONES:
        disc = lathe((x, y, 0.016), [(0.195, -0.016), (0.18, 0.0), (0.003, 0.004)], 0.032)
        tone = 0.07 * waves(disc.means, rng, 0.12) + 0.05 * rng.normal(size=len(disc)) + 0.08 * rng.normal()
        parts.append(painted(disc, shades((0.60, 0.58, 0.54), tone)))
    return join(parts)


def bed(
    x: tuple[float, float], y: tuple[float, float], blossom_colors: tuple[Color, ...], count: int, rng: Rng
) -> Surfels:
    """Build a strip of soil with flowers in it."""
    soil = Rectangle((x[0], y[0], 0.015), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), x[1] - x[0], y[1] - y[0])
    st, size = soil.cells(0.06)
    dirt = shades((0.30, 0.22, 0.16), 0.2 * rng.normal(size=len(st)))
    parts = [soil.surfels(st, size, dirt, 0.01 * rng.random(len(st)))]
    for index in range(count):
        along, across = (index + rng.uniform(0.2, 0.8)) / count, rng.uniform(0.25, 0.75)
        foot = (x[0] + along * (x[1] - x[0]), y[0] + across * (y[1] - y[0]))
        if y[1] - y[0] > x[1] - x[0]:
            foot = (x[0] + across * (x[1] - x[0]), y[0] + along * (y[1] - y[0]))
        parts.append(flowers(foot, blossom_colors[index % len(blossom_colors)], rng))
    return join(parts)


def flowers(foot: tuple[float, float], color: Color, rng: Rng) -> Surfels:
    """Build a clump of flowers: leaves below, blossoms on top."""
    height = rng.uniform(0.16, 0.3)
    green = shrub(
        (*foot, 0.5 * height), (0.13, 0.13, 0.5 * height), 45, 0.05, ((0.22, 0.38, 0.15), (0.36, 0.52, 0.22)), rng
    )
    count = 22
    spread = rng.normal(scale=(0.075, 0.075, 0.035), size=(count, 3)) + np.array([*foot, height + 0.03])
    tone = shades(color, 0.1 * rng.normal(size=count))
    heads = surfels(spread, np.eye(3), (0.018, 0.018, 0.012), tone, np.array([0.0, 0.0, 0.4]))
    return join([green, heads])


def country(
    rect: Rect, rng: Rng, greens: tuple[Color, Color] = GREENS, far: Color = FAR, offset: float = 0.0
) -> Surfels:
    """Build the land outside a yard: rings of increasingly large surfels, which fade into the haze of the horizon.

    Args:
        rect: extent of the yard, which contains the origin.
        rng: generator of the colours' grain.
        greens: colours of fresh and dry grass.
        far: colour of the land at the horizon, sRGB.
        offset: angle by which the first ring is turned, as a fraction of that between two of its surfels; each further
            ring is turned by another half.
    """
    x0, y0, x1, y1 = rect
    rings: list[Surfels] = []
    radius = min(-x0, -y0, x1, y1)
    while radius < RADIUS:
        step = 0.16 * radius
        around = round(2 * np.pi * radius / step)
        angles = (np.arange(around) + (offset + 0.5 * len(rings)) % 1.0) * 2 * np.pi / around
        points = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(around, -0.02)], -1)
        margin = 0.45 * step
        points = points[~within(points, (x0 - margin, y0 - margin, x1 + margin, y1 + margin))]
        haze = min(1.0, radius / RADIUS)
        colors = (1 - haze) * lawn_colors(points, rng, greens) + haze * np.array(far)
        if len(points):
            rings.append(surfels(points, np.eye(3), (0.72 * step, 0.72 * step, THICKNESS), colors))
        radius += step
    return join(rings)
