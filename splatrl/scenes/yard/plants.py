"""Leaves, grass, flowers and trees."""

import numpy as np

from splatrl.scenes.yard.layout import Tree
from splatrl.scenes.yard.materials import Color, Rng, mixed, shades, waves
from splatrl.scenes.yard.surfels import Array, Surfels, frames, join, lathe, painted, surfels


def leaves(points: Array, outward: Array, depth: Array, size: float, palette: tuple[Color, Color], rng: Rng) -> Surfels:
    """Build leaves that face roughly outward and are darker the deeper they sit.

    Args:
        points: [N, 3] centres of the leaves, metres.
        outward: [N, 3] unit vectors that point out of the plant.
        depth: [N] in [0, 1], 0 at the surface of the plant.
        size: half a leaf's length, metres.
        palette: two colours between which leaves vary.
        rng: generator of colours, sizes and directions.
    """
    count = len(points)
    facing = outward + 0.8 * rng.normal(size=(count, 3))
    scales = size * rng.uniform(0.6, 1.15, (count, 1)) * np.array([0.75, 0.45, 0.08])
    colors = mixed(*palette, rng.normal(0.5, 0.35, count)) * (1 - 0.55 * depth)[:, None]
    normals = 0.55 * outward + 0.2 * facing / np.linalg.norm(facing, axis=1, keepdims=True)
    normals[:, 2] += 0.12
    return surfels(points, frames(facing, rng.normal(size=(count, 3))), scales, colors, normals, 0.92)


def ball(center: Array, radii: Array, count: int, rng: Rng, shell: float = 0.55) -> tuple[Array, Array, Array]:
    """Draw points in the outer part of an ellipsoid.

    Args:
        center: [3] centre of the ellipsoid, metres.
        radii: [3] half extents of the ellipsoid, metres.
        count: N.
        rng: generator of the points.
        shell: smallest distance from the centre, as a fraction of the radius.

    Returns:
        Positions [N, 3], outward unit vectors [N, 3], and depths [N], from 0 at the surface to 1.
    """
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    radius = rng.uniform(shell**2, 1.0, count) ** 0.5
    return center + radii * outward * radius[:, None], outward, (1 - radius) / (1 - shell)


def shrub(
    center: tuple[float, float, float],
    radii: tuple[float, float, float],
    count: int,
    size: float,
    palette: tuple[Color, Color],
    rng: Rng,
) -> Surfels:
    """Build a round bush around a dark core that lets no light through."""
    middle, extent = np.asarray(center), np.asarray(radii)
    core, outward, _ = ball(middle, 0.7 * extent, max(12, count // 12), rng)
    width = 0.3 * float(extent.min())
    dark = surfels(
        core,
        frames(outward, rng.normal(size=3)),
        (width, width, 0.5 * width),
        shades(palette[0], np.full(len(core), -0.62)),
    )
    return join([dark, leaves(*ball(middle, extent, count, rng), size, palette, rng)])


def blossoms(
    center: tuple[float, float, float],
    radii: tuple[float, float, float],
    count: int,
    size: float,
    color: Color,
    rng: Rng,
) -> Surfels:
    """Build blossoms on the surface of a bush."""
    points, outward, _ = ball(np.asarray(center), 1.04 * np.asarray(radii), count, rng, shell=0.85)
    tone = shades(color, 0.1 * rng.normal(size=count))
    return surfels(points, frames(outward, rng.normal(size=3)), (size, size, 0.7 * size), tone, 0.6 * outward)


BARK = (0.42, 0.33, 0.25)
GREENS = ((0.27, 0.42, 0.13), (0.60, 0.60, 0.27))
"""Colours of a lawn: fresh and dry."""


def tree(spec: Tree, count: int, palette: tuple[Color, Color], rng: Rng, bark_color: Color = BARK) -> Surfels:
    """Build a tree: a trunk with bark, and a crown of overlapping balls of leaves."""
    top = spec.crown_height
    step = 0.7 * spec.trunk_radius
    profile = [(1.5 * spec.trunk_radius, 0.0), (spec.trunk_radius, 0.25), (0.75 * spec.trunk_radius, top)]
    trunk = lathe((spec.x, spec.y, 0.0), profile, step)
    bark = 0.14 * waves(trunk.means * np.array([1, 1, 0.25]), rng, 0.1) + 0.1 * rng.normal(size=len(trunk))
    parts = [painted(trunk, shades(bark_color, bark))]
    middle, size = np.array([spec.x, spec.y, top]), spec.crown_radius
    centers = ball(middle, 0.62 * size * np.array([1.0, 1.0, 0.8]), 11, rng)[0]
    shares = np.full(len(centers), count // len(centers))
    for center, share in zip(centers, shares, strict=True):
        radii = 0.46 * size * rng.uniform(0.75, 1.25) * np.array([1.0, 1.0, 0.75])
        x, y, z = (float(v) for v in center)
        leaf = 1.1 * size / np.sqrt(share)
        parts.append(
            shrub((x, y, z), (float(radii[0]), float(radii[1]), float(radii[2])), int(share), leaf, palette, rng)
        )
    return join(parts)


def grass(points: Array, length: float, rng: Rng, greens: tuple[Color, Color] = GREENS) -> Surfels:
    """Build blades of grass at points on the lawn, which lean and are lighter than the ground below.

    Args:
        points: [N, 3] feet of the blades, metres.
        length: nominal length of a blade, metres.
        rng: generator of lean, length and colour.
        greens: colours of fresh and dry grass.
    """
    count = len(points)
    blade = rng.normal(scale=(0.45, 0.45, 0.0), size=(count, 3)) + np.array([0.0, 0.0, 1.0])
    blade /= np.linalg.norm(blade, axis=1, keepdims=True)
    half = 0.5 * length * rng.uniform(0.5, 1.1, count)
    scales = np.stack([0.6 * half, 0.07 * half + 0.0012, np.full(count, 0.0008)], -1)
    colors = lawn_colors(points, rng, greens) * rng.uniform(0.85, 1.4, (count, 1))
    normals = np.broadcast_to(np.array([0.0, 0.0, 0.75]), (count, 3))
    axes = frames(np.cross(blade, rng.normal(size=(count, 3))), blade)
    return surfels(points + half[:, None] * blade, axes, scales, colors, normals, 0.9)


def lawn_colors(points: Array, rng: Rng, greens: tuple[Color, Color] = GREENS) -> Array:
    """Return the greens of a lawn at points [N, 3] on it: large patches, drier spots and fine grain; [N, 3] sRGB."""
    fixed = np.random.default_rng(20)  # blades and the ground beneath them share their patches
    flat = points * np.array([1.0, 1.0, 0.0])
    dry = 0.28 + 0.16 * waves(flat, fixed, 1.6) + 0.12 * waves(flat, fixed, 0.45) + 0.1 * rng.normal(size=len(points))
    return shades(mixed(*greens, dry), 0.07 * waves(flat, fixed, 0.2))
