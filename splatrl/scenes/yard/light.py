"""Sunlight, skylight and shadow, baked into the colours of surfels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.yard.layout import Solid, Tree
from splatrl.scenes.yard.surfels import Array, Surfels

SUN = np.array([-0.50, -0.47, 0.73])
"""Unit vector to the sun, in the south-west: hedge and fence lie in the light, wall and shed in the shade."""
SUN_COLOR = np.array([1.0, 0.93, 0.78]) * 1.62
SKY_COLOR = np.array([0.62, 0.74, 0.95]) * 0.9
GROUND_COLOR = np.array([0.50, 0.52, 0.34]) * 0.35
"""Light that the lawn reflects onto surfaces that face it."""


@dataclass(frozen=True)
class Light:
    """The light that falls on a yard.

    Attributes:
        sun: [3] unit vector to the sun.
        sun_color: [3] linear light of the sun on a surface that faces it.
        sky_color: [3] linear light of the open sky.
        ground_color: [3] linear light that the ground reflects onto surfaces that face it.
    """

    sun: Array
    sun_color: Array
    sky_color: Array
    ground_color: Array


SUNNY = Light(SUN, SUN_COLOR, SKY_COLOR, GROUND_COLOR)
PENUMBRA = 0.035
"""Spread of the directions to the sun over which shadows are averaged."""
RAYS = 5
CONTACT = 0.16
"""Metres over which the ground occludes the sky at a thing's foot, and a thing occludes it on the ground."""


@dataclass(frozen=True)
class Occluders:
    """Everything that casts shadows: boxes, which are opaque, and tree crowns, which let some light through.

    Attributes:
        low: [B, 3] lower corners of the boxes, metres.
        high: [B, 3] upper corners of the boxes, metres.
        centers: [C, 3] centres of the crowns, metres.
        radii: [C, 3] half extents of the crowns, metres.
    """

    low: Array
    high: Array
    centers: Array
    radii: Array


def occluders(solids: list[Solid], trees: tuple[Tree, ...], shrink: float = 0.012) -> Occluders:
    """Build occluders slightly smaller than the things, so that a surface does not shadow itself."""
    return Occluders(
        low=np.array([s.low for s in solids]) + shrink,
        high=np.array([s.high for s in solids]) - shrink,
        centers=np.array([(t.x, t.y, t.crown_height) for t in trees]),
        radii=np.array([(t.crown_radius, t.crown_radius, 0.8 * t.crown_radius) for t in trees]),
    )


def in_box(points: Array, direction: Array, blockers: Occluders) -> NDArray[np.bool_]:
    """Return whether a ray from each point enters a box (slab test); a box never shades points inside it.

    Args:
        points: [N, 3] world, metres.
        direction: [3] direction of the rays.
        blockers: the boxes.

    Returns:
        [N] bool.
    """
    safe = np.where(np.abs(direction) < 1e-6, 1e-6, direction)
    hit = np.zeros(len(points), bool)
    scaled = np.ascontiguousarray((points / safe).T)  # [3, N]: the reductions below run along contiguous memory
    for low, high in zip(blockers.low / safe, blockers.high / safe, strict=True):
        first, second = low[:, None] - scaled, high[:, None] - scaled
        enter, leave = np.minimum(first, second).max(0), np.maximum(first, second).min(0)
        hit |= (leave > enter) & (enter > 0.0)
    return hit


def through_crowns(points: Array, direction: Array, blockers: Occluders) -> Array:
    """Return the fraction of light that reaches each point through tree crowns; longer paths let less through.

    Args:
        points: [N, 3] world, metres.
        direction: [3] direction to the light.
        blockers: the crowns.

    Returns:
        [N] in [0, 1].
    """
    share = np.ones(len(points))
    for center, radii in zip(blockers.centers, blockers.radii, strict=True):
        start, way = (points - center) / radii, direction / radii
        a, b, c = way @ way, start @ way, (start * start).sum(1) - 1
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        length = np.maximum((root - b) / a, 0.0) - np.maximum((-b - root) / a, 0.0)
        share *= np.exp(-1.1 * length / radii[0])
    return share


def sunlight(points: Array, blockers: Occluders, sun: Array = SUN) -> Array:
    """Return the fraction of the sun's disc, in direction ``sun`` [3], that each point [N, 3] sees: [N] in [0, 1]."""
    total = np.zeros(len(points))
    for ray in range(RAYS):
        angle = 2 * np.pi * ray / RAYS
        spread = PENUMBRA * np.array([np.cos(angle), np.sin(angle), 0.3 * np.cos(2 * angle)])
        direction = (sun + spread) / np.linalg.norm(sun + spread)
        total += np.where(in_box(points, direction, blockers), 0.0, through_crowns(points, direction, blockers))
    return total / RAYS


def openness(points: Array, normals: Array, blockers: Occluders) -> Array:
    """Return the visible fraction of the sky near contacts: the feet of things and the ground there are darker.

    Args:
        points: [N, 3] world, metres.
        normals: [N, 3] surface normals, see ``Surfels``.
        blockers: the things.

    Returns:
        [N] in [0, 1].
    """
    height = np.maximum(points[:, 2], 0.0)
    flat = np.maximum(normals[:, 2], 0.0)
    foot = 1 - 0.45 * (1 - flat) * np.exp(-height / CONTACT)
    low, high = blockers.low[:, None], blockers.high[:, None]
    gap = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1).min(0)
    return foot * (1 - 0.5 * flat * np.exp(-gap / CONTACT) * np.exp(-height / CONTACT))


def to_linear(srgb: Array) -> Array:
    """Convert sRGB in [0, 1] to linear light, in any shape."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Array) -> Array:
    """Convert linear light to sRGB in [0, 1], in any shape; highlights roll off rather than clip."""
    rolled = np.where(linear < 0.6, linear, 0.6 + 0.4 * np.tanh((linear - 0.6) / 0.4))
    return np.where(rolled <= 0.0031308, 12.92 * rolled, 1.055 * np.maximum(rolled, 1e-9) ** (1 / 2.4) - 0.055)


def lit(part: Surfels, blockers: Occluders, light: Light = SUNNY) -> Surfels:
    """Return the surfels with the light of the yard baked in (Lambert's law, one bounce from the ground)."""
    straight = np.linalg.norm(part.normals, axis=1)
    facing = np.clip(part.normals @ light.sun + (1 - straight), 0.0, 1.0)
    sun = facing * sunlight(part.means + 0.01 * part.normals, blockers, light.sun)
    up = 0.5 + 0.5 * part.normals[:, 2]
    sky = (openness(part.means, part.normals, blockers) * up)[:, None] * light.sky_color
    arriving = sun[:, None] * light.sun_color + sky + (1 - up)[:, None] * light.ground_color
    colors = to_srgb(to_linear(part.colors) * arriving)
    return Surfels(part.means, part.axes, part.scales, colors, part.normals, part.opacities)
