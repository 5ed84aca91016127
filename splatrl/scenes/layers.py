"""Flat layers of a scene: planes near which much of its surface lies."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_DIRECTIONS = 500
ALIGNED = 0.8
"""Cosine to the layer's normal, times flatness, above which a Gaussian counts as lying flat in the layer."""
_LOOSE = 0.3
"""Weight factor of a Gaussian that is in a layer but does not lie flat in it."""
_APART = np.cos(np.radians(30.0))
_RIVALS = 5
_CONES = (15.0, 15.0, 10.0, 10.0, 6.0, 6.0, 6.0)
"""Degrees from up, or from perpendicular to it, within which normals count: narrower with each iteration."""
_LEANS = np.cos(np.radians(15.0))
_ASTRAY = np.cos(np.radians(3.0))
_KEPT = 0.9
_FEWEST = 10
_EDGE = 1.0 + 1e-6
"""Factor on a layer's thickness, so that rounding cuts no perfectly flat floor that lies exactly on its edge."""
_SLENDER = 0.01


@dataclass(frozen=True, eq=False)
class Layer:
    """The points around a plane.

    Attributes:
        normal: [3] unit vector; its sign has no meaning.
        height: height of the plane along the normal.
        thickness: distance from the plane, on either side, within which points belong to the layer.
        weight: fraction of the total weight that lies in the layer; Gaussians that are not flat in it count less.
    """

    normal: Floats
    height: float
    thickness: float
    weight: float


def heavy_layers(points: Floats, normals: Floats, weights: Floats, thickness: float) -> list[Layer]:
    """Return the heaviest layers over all directions, heaviest first, with normals at least 30° apart.

    Args:
        points: [N, 3] means of the Gaussians, in their own frame and unit.
        normals: [N, 3] normals of the Gaussians; their length, 0 to 1, is the flatness.
        weights: [N] weights of the Gaussians, summing to 1.
        thickness: thickness of the layers on either side of their planes, in the same unit.
    """
    directions = np.concatenate([np.eye(3), _hemisphere(_DIRECTIONS)])
    layers = [layer_at(points, normals, weights, direction, thickness) for direction in directions]
    result: list[Layer] = []
    while layers and len(result) < _RIVALS:
        result.append(max(layers, key=lambda layer: layer.weight))
        layers = [layer for layer in layers if abs(layer.normal @ result[-1].normal) < _APART]
    return result


def layer_at(points: Floats, normals: Floats, weights: Floats, normal: Floats, thickness: float) -> Layer:
    """Return the heaviest layer with a given normal.

    Args:
        points: see ``heavy_layers``.
        normals: see ``heavy_layers``.
        weights: see ``heavy_layers``.
        normal: [3] unit vector, the normal of the layer.
        thickness: see ``heavy_layers``.
    """
    heights = points @ normal
    flat = np.abs(normals @ normal) > ALIGNED
    mass = weights * np.where(flat, 1.0, _LOOSE)
    low, high = np.quantile(heights, [0.002, 0.998]) if len(heights) > 2 else (heights.min(), heights.max())
    inside = (heights >= low) & (heights <= high)
    bins = np.floor((heights[inside] - low) / thickness * 2).astype(np.int64)  # bins of half a thickness
    sums = np.convolve(np.bincount(bins, mass[inside]), np.ones(4))  # four bins cover both sides of the plane
    best = int(sums.argmax())  # the sum over bins best - 3 … best
    center = low + (best - 1) * 0.5 * thickness
    within = np.abs(heights - center) <= _EDGE * thickness
    if not within.any():
        return Layer(normal, float(center), thickness, 0.0)
    order = heights[within].argsort()
    cumulated = mass[within][order].cumsum()
    median = heights[within][order][np.searchsorted(cumulated, 0.5 * cumulated[-1])]
    return Layer(normal, float(median), thickness, float(mass[within].sum()))


def leaning_layer(points: Floats, normals: Floats, weights: Floats, layer: Layer) -> Layer:
    """Tilt a layer by at most 15° so that it fits flat surfaces, upright surfaces and the plane of its points.

    First come the normals: up is the direction to which those of the floor are parallel and those of the walls are
    perpendicular, the smallest eigenvector of the difference of their scatter matrices. Then a plane is fitted to the
    flat Gaussians of the layer, which is more precise; it is discarded if it tilts away from what the normals say.
    Neither step may cost the layer much of its weight.

    Args:
        points: see ``heavy_layers``.
        normals: see ``heavy_layers``.
        weights: see ``heavy_layers``.
        layer: the layer to tilt.
    """
    for lean in (_between(normals, weights, layer.normal), None):
        normal = _plane(points, normals, weights, layer) if lean is None else lean
        leaning = None if normal is None else layer_at(points, normals, weights, normal, layer.thickness)
        if leaning is not None and leaning.weight > _KEPT * layer.weight:
            layer = leaning
    return layer


def _between(normals: Floats, weights: Floats, up: Floats) -> Floats:
    """Return the direction near ``up`` to which most surfaces are perpendicular or parallel: [3]."""
    flatness = np.linalg.norm(normals, axis=1)
    directions, mass = normals / np.maximum(flatness, 1e-9)[:, None], weights * flatness
    start = up
    for cone in np.radians(_CONES):
        cosine = np.abs(directions @ up)
        floor, walls = (cosine > np.cos(cone)) * mass, (cosine < np.sin(cone)) * mass
        signed = 0.5 * walls - floor
        leaning = np.linalg.eigh((directions * signed[:, None]).T @ directions)[1][:, 0]
        leaning *= np.sign(leaning @ up) or 1.0
        if not signed.any() or leaning @ start < _LEANS:
            return up
        up = leaning
    return up


def _plane(points: Floats, normals: Floats, weights: Floats, layer: Layer) -> Floats | None:
    """Return the normal of a plane fitted to a layer's flat points, unless they are too few or in line, or it tilts."""
    normal, height = layer.normal, layer.height
    for shrink in (1.0, 0.5, 0.25, 0.25):
        within = np.abs(points @ normal - height) <= shrink * layer.thickness
        within &= np.abs(normals @ layer.normal) > ALIGNED
        if within.sum() < _FEWEST:
            return None
        middle = np.average(points[within], axis=0, weights=weights[within])
        offsets = points[within] - middle
        spread, axes = np.linalg.eigh((offsets * weights[within, None]).T @ offsets)
        if spread[1] < _SLENDER * spread[2]:  # a line does not determine a plane
            return None
        normal = axes[:, 0] * (np.sign(axes[:, 0] @ layer.normal) or 1.0)
        height = float(middle @ normal)
        if normal @ layer.normal < _ASTRAY:
            return None
    return normal


def _hemisphere(count: int) -> Floats:
    """Return evenly spread directions on a hemisphere (a Fibonacci lattice): [count, 3]."""
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], 1)
