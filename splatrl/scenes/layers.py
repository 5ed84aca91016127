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
_DRIFT = np.cos(np.radians(10.0))


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


def heaviest_layer(points: Floats, normals: Floats, weights: Floats, thickness: float) -> tuple[Layer, float]:
    """The layer with the most weight over all directions.

    Args:
        points: [N, 3].
        normals: [N, 3]; the length, 0 to 1, says how flat a Gaussian is.
        weights: [N], summing to 1.
        thickness: of the layer.

    Returns:
        The layer, and the weight of the heaviest one whose normal is at least 30° away.
    """
    directions = np.concatenate([np.eye(3), _hemisphere(_DIRECTIONS)])
    layers = [layer_at(points, normals, weights, direction, thickness) for direction in directions]
    heaviest = max(layers, key=lambda layer: layer.weight)
    apart = np.abs(directions @ heaviest.normal) < _APART
    return heaviest, max(layer.weight for layer, far in zip(layers, apart, strict=True) if far)


def layer_at(points: Floats, normals: Floats, weights: Floats, normal: Floats, thickness: float) -> Layer:
    """The heaviest layer with a given normal; arguments as for ``heaviest_layer``."""
    heights = points @ normal
    flat = np.abs(normals @ normal) > ALIGNED
    mass = weights * np.where(flat, 1.0, _LOOSE)
    low, high = np.quantile(heights, [0.002, 0.998])
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


def tilted_layer(points: Floats, normals: Floats, weights: Floats, layer: Layer) -> Layer:
    """Tilt a layer by at most 10° to fit its points, as long as that costs it hardly any weight."""
    start = layer.normal
    for shrink in (1.0, 1.0, 0.5, 0.5, 0.25, 0.25):
        within = np.abs(points @ layer.normal - layer.height) <= shrink * layer.thickness
        mass = (weights * np.where(np.abs(normals @ layer.normal) > ALIGNED, 1.0, _LOOSE))[within]
        if within.sum() < 10 or mass.sum() == 0.0:
            break
        offsets = points[within] - np.average(points[within], axis=0, weights=mass)
        normal = np.linalg.eigh((offsets * mass[:, None]).T @ offsets)[1][:, 0]
        turned = layer_at(points, normals, weights, normal * np.sign(normal @ layer.normal), layer.thickness)
        if turned.weight < 0.98 * layer.weight or turned.normal @ start < _DRIFT:
            break
        layer = turned
    return layer


def _hemisphere(count: int) -> Floats:
    """Evenly spread directions on half a sphere (a Fibonacci lattice): [count, 3]."""
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], 1)
