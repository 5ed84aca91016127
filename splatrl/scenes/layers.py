"""Flat layers of a scene: planes that much of its surface lies near."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_DIRECTIONS = 500
ALIGNED = 0.8
"""Cosine, times flatness, above which a Gaussian lies flat in a layer."""
_LOOSE = 0.3
"""Weight of a Gaussian that is in a layer but does not lie flat in it."""
_APART = np.cos(np.radians(30.0))
_RIVALS = 5
_CONES = (15.0, 15.0, 10.0, 10.0, 6.0, 6.0, 6.0)
"""Degrees around up, and around what lies across it, in which normals count; narrower as up becomes known."""
_LEANS = np.cos(np.radians(15.0))
_ASTRAY = np.cos(np.radians(3.0))
_KEPT = 0.9
_FEWEST = 10
_SLENDER = 0.01


@dataclass(frozen=True, eq=False)
class Layer:
    """The points around a plane.

    Attributes:
        normal: [3] unit vector; its sign has no meaning.
        height: of the plane along the normal.
        thickness: points within this distance on either side belong to the layer.
        weight: share of the total weight that lies in the layer; Gaussians that are not flat in it count less.
    """

    normal: Floats
    height: float
    thickness: float
    weight: float


def heavy_layers(points: Floats, normals: Floats, weights: Floats, thickness: float) -> list[Layer]:
    """The layers with the most weight over all directions, the heaviest first, with normals at least 30° apart.

    Args:
        points: [N, 3].
        normals: [N, 3]; the length, 0 to 1, says how flat a Gaussian is.
        weights: [N], summing to 1.
        thickness: of the layers.
    """
    directions = np.concatenate([np.eye(3), _hemisphere(_DIRECTIONS)])
    layers = [layer_at(points, normals, weights, direction, thickness) for direction in directions]
    result: list[Layer] = []
    while layers and len(result) < _RIVALS:
        result.append(max(layers, key=lambda layer: layer.weight))
        layers = [layer for layer in layers if abs(layer.normal @ result[-1].normal) < _APART]
    return result


def layer_at(points: Floats, normals: Floats, weights: Floats, normal: Floats, thickness: float) -> Layer:
    """The heaviest layer with a given normal; arguments as for ``heaviest_layer``."""
    heights = points @ normal
    flat = np.abs(normals @ normal) > ALIGNED
    mass = weights * np.where(flat, 1.0, _LOOSE)
    low, high = np.quantile(heights, [0.002, 0.998]) if len(heights) > 2 else (heights.min(), heights.max())
    inside = (heights >= low) & (heights <= high)
    bins = np.floor((heights[inside] - low) / thickness * 2).astype(np.int64)  # half a thickness each
    sums = np.convolve(np.bincount(bins, mass[inside]), np.ones(4))  # both sides of the plane
    best = int(sums.argmax())  # the sum over bins best - 3 … best
    center = low + (best - 1) * 0.5 * thickness
    within = np.abs(heights - center) <= thickness
    if not within.any():
        return Layer(normal, float(center), thickness, 0.0)
    order = heights[within].argsort()
    cumulated = mass[within][order].cumsum()
    median = heights[within][order][np.searchsorted(cumulated, 0.5 * cumulated[-1])]
    return Layer(normal, float(median), thickness, float(mass[within].sum()))


def leaning_layer(points: Floats, normals: Floats, weights: Floats, layer: Layer) -> Layer:
    """Lean a layer by at most 15°, so that the flat lies in it, the upright stands on it and its points are a plane.

    First come the normals: up is the direction along which those of the floor point and across which those of the
    walls do, the smallest eigenvector of the difference of their scatter matrices. Then a plane is fitted to the flat
    Gaussians of the layer, which is finer, and is dropped where it leans away from what the normals say. Neither may
    cost the layer much of its weight.
    """
    for lean in (_between(normals, weights, layer.normal), None):
        normal = _plane(points, normals, weights, layer) if lean is None else lean
        leaning = None if normal is None else layer_at(points, normals, weights, normal, layer.thickness)
        if leaning is not None and leaning.weight > _KEPT * layer.weight:
            layer = leaning
    return layer


def _between(normals: Floats, weights: Floats, up: Floats) -> Floats:
    """The direction near ``up`` that surfaces lie across or along: [3]."""
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
    """Normal of the plane through a layer's flat points; None where there are too few, or it leans away."""
    normal, height = layer.normal, layer.height
    for shrink in (1.0, 0.5, 0.25, 0.25):
        within = np.abs(points @ normal - height) <= shrink * layer.thickness
        within &= np.abs(normals @ layer.normal) > ALIGNED
        if within.sum() < _FEWEST:
            return None
        middle = np.average(points[within], axis=0, weights=weights[within])
        offsets = points[within] - middle
        spread, axes = np.linalg.eigh((offsets * weights[within, None]).T @ offsets)
        if spread[1] < _SLENDER * spread[2]:  # a line leans anyhow
            return None
        normal = axes[:, 0] * (np.sign(axes[:, 0] @ layer.normal) or 1.0)
        height = float(middle @ normal)
        if normal @ layer.normal < _ASTRAY:
            return None
    return normal


def _hemisphere(count: int) -> Floats:
    """Evenly spread directions on half a sphere (a Fibonacci lattice): [count, 3]."""
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], 1)
