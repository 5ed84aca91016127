"""Surfels: the flat Gaussians that the backyard is made of, before and after lighting."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
THICKNESS = 0.004
"""Standard deviation of a surfel along its normal, metres."""
OVERLAP = 0.68
"""Ratio of standard deviation to spacing, at which neighbours close every gap and details stay sharp."""
OPAQUE = 0.96


@dataclass(frozen=True)
class Surfels:
    """N surfels.

    Attributes:
        means: [N, 3] metres, world frame.
        axes: [N, 3, 3] rotations; column k is the direction of ``scales[:, k]``, column 2 the thin one.
        scales: [N, 3] standard deviations, metres.
        colors: [N, 3] sRGB in [0, 1]: the surface's reflectance or, once lit, its visible colour.
        normals: [N, 3] surface normals for lighting; the shorter a normal is than 1, the more light shines through
            from all sides.
        opacities: [N].
    """

    means: Array
    axes: Array
    scales: Array
    colors: Array
    normals: Array
    opacities: Array

    def __len__(self) -> int:
        return len(self.means)


def join(parts: Iterable[Surfels]) -> Surfels:
    """Concatenate the surfels of the parts in order."""
    listed = list(parts)
    return Surfels(*(np.concatenate([getattr(part, field.name) for part in listed]) for field in fields(Surfels)))


def frames(normals: Array, along: Array) -> Array:
    """Return rotations whose third column is the normal and whose first is as close to ``along`` as that allows.

    Args:
        normals: [N, 3], of any length but zero.
        along: [N, 3] or [3], not parallel to the normal.

    Returns:
        [N, 3, 3].
    """
    third = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    second = np.cross(third, np.broadcast_to(along, third.shape))
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([np.cross(second, third), second, third], -1)


def surfels(
    means: Array,
    axes: Array,
    scales: Array | tuple[float, float, float],
    colors: Array | tuple[float, float, float],
    normals: Array | None = None,
    opacity: float = OPAQUE,
) -> Surfels:
    """Build N surfels from values that they may share.

    Args:
        means: [N, 3] metres.
        axes: [N, 3, 3] or [3, 3] rotations, see ``Surfels``.
        scales: [N, 3] or [3] standard deviations, metres.
        colors: [N, 3] or [3] sRGB, clipped to [0, 1].
        normals: [N, 3] or [3] surface normals; None takes the third axes.
        opacity: opacity of all of them.
    """
    count = len(means)
    axes = np.broadcast_to(axes, (count, 3, 3))
    return Surfels(
        means=np.asarray(means, np.float64),
        axes=axes,
        scales=np.broadcast_to(np.asarray(scales, np.float64), (count, 3)),
        colors=np.clip(np.broadcast_to(np.asarray(colors, np.float64), (count, 3)), 0.0, 1.0),
        normals=axes[:, :, 2] if normals is None else np.broadcast_to(normals, (count, 3)),
        opacities=np.full(count, opacity),
    )


@dataclass(frozen=True)
class Rectangle:
    """A flat rectangle, seen from the side to which ``right × up`` points.

    Attributes:
        corner: its lower left corner, metres, world frame.
        right: unit vector.
        up: unit vector at a right angle to ``right``.
        width: metres along ``right``.
        height: metres along ``up``.
    """

    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    width: float
    height: float

    def cells(self, step: float, tall: float | None = None) -> tuple[Array, tuple[float, float]]:
        """Return the centres [N, 2] of a grid of whole cells of about ``step`` by ``tall`` metres, and their size."""
        columns = max(1, round(self.width / step))
        rows = max(1, round(self.height / (tall or step)))
        size = (self.width / columns, self.height / rows)
        s, t = np.meshgrid((np.arange(columns) + 0.5) * size[0], (np.arange(rows) + 0.5) * size[1])
        return np.stack([s.ravel(), t.ravel()], -1), size

    def points(self, st: Array, lift: float | Array = 0.0) -> Array:
        """Return the world positions [N, 3] of points [N, 2] on the rectangle, ``lift`` metres in front of it."""
        right, up = np.asarray(self.right), np.asarray(self.up)
        lifted = np.asarray(lift)[..., None] * np.cross(right, up)
        return np.asarray(self.corner) + st[:, :1] * right + st[:, 1:] * up + lifted

    def surfels(
        self, st: Array, size: Array | tuple[float, float], colors: Array, lift: float | Array = 0.0
    ) -> Surfels:
        """Build surfels that cover cells.

        Args:
            st: [N, 2] centres of the cells.
            size: width and height of each cell, [N, 2], or of all cells, metres.
            colors: [N, 3] sRGB.
            lift: distance in front of the rectangle, metres.
        """
        right, up = np.asarray(self.right), np.asarray(self.up)
        axes = np.stack([right, up, np.cross(right, up)], -1)
        sizes = np.broadcast_to(np.asarray(size), (len(st), 2))
        scales = np.concatenate([OVERLAP * sizes, np.full((len(st), 1), THICKNESS)], 1)
        return surfels(self.points(st, lift), axes, scales, colors)


def faces(
    low: tuple[float, float, float], high: tuple[float, float, float], sides: str = "+x-x+y-y+z"
) -> list[Rectangle]:
    """Return sides of a box as rectangles seen from outside; ``sides`` names them by sign and axis."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    width, depth, height = x1 - x0, y1 - y0, z1 - z0
    up = (0.0, 0.0, 1.0)
    every = {
        "+x": Rectangle((x1, y0, z0), (0.0, 1.0, 0.0), up, depth, height),
        "-x": Rectangle((x0, y1, z0), (0.0, -1.0, 0.0), up, depth, height),
        "+y": Rectangle((x1, y1, z0), (-1.0, 0.0, 0.0), up, width, height),
        "-y": Rectangle((x0, y0, z0), (1.0, 0.0, 0.0), up, width, height),
        "+z": Rectangle((x0, y0, z1), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), width, depth),
        "-z": Rectangle((x0, y1, z0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), width, depth),
    }
    return [every[sides[i : i + 2]] for i in range(0, len(sides), 2)]


def lathe(
    center: tuple[float, float, float], profile: list[tuple[float, float]], step: float, lying: bool = False
) -> Surfels:
    """Build a surface of revolution about the vertical through ``center``, or about +x if ``lying``.

    It is white, to be painted.

    Args:
        center: foot of the axis, metres, world frame.
        profile: (radius, height) of the outline from bottom to top, metres; outside is to the right of it.
        step: spacing of the surfels, metres.
        lying: whether to turn z into x, x into y and y into z.
    """
    rings: list[Surfels] = []
    outline = np.asarray(profile)
    for start, end in pairwise(outline):
        length = float(np.hypot(*(end - start)))
        count = max(1, round(length / step))
        tangent = (end - start) / length
        for radius, height in start + (end - start) * ((np.arange(count) + 0.5) / count)[:, None]:
            around = max(5, round(2 * np.pi * radius / step))
            angles = (np.arange(around) + 0.37 * len(rings)) * 2 * np.pi / around
            cos, sin, zero = np.cos(angles), np.sin(angles), np.zeros(around)
            slope = np.stack([tangent[0] * cos, tangent[0] * sin, zero + tangent[1]], -1)
            circle = np.stack([-sin, cos, zero], -1)
            axes = np.stack([circle, slope, np.cross(circle, slope)], -1)
            scales = (OVERLAP * 2 * np.pi * radius / around, OVERLAP * length / count, THICKNESS)
            rings.append(
                surfels(np.stack([radius * cos, radius * sin, zero + height], -1), axes, scales, (1.0, 1.0, 1.0))
            )
    whole = join(rings)
    turn = np.roll(np.eye(3), 1, axis=0) if lying else np.eye(3)
    axes = turn @ whole.axes
    return surfels(whole.means @ turn.T + np.asarray(center), axes, whole.scales, whole.colors)


def painted(part: Surfels, colors: Array | tuple[float, float, float]) -> Surfels:
    """Return the same surfels in other colours, [N, 3] or a single colour."""
    return surfels(part.means, part.axes, part.scales, colors, part.normals, float(part.opacities[0]))
