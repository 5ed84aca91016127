"""An independent, slow test of whether a body touches a voxel, by separating axes and closest points in float64."""

import numpy as np

from splatrl.bodies import Body, Box, Capsule, Sphere
from splatrl.collision import Occupancy


def separation(body: Body, body_to_world: np.ndarray, occupancy: Occupancy) -> float:
    """Return a signed separation of body and solid voxels, metres: positive if apart, negative if they overlap.

    The absolute value need not be a distance; it is small wherever the answer depends on rounding.
    """
    centers = (occupancy.keys() + 0.5) * occupancy.resolution - body_to_world[:3, 3]
    half = 0.5 * occupancy.resolution
    rotation = body_to_world[:3, :3]
    match body:
        case Box():
            return float(_box_gaps(0.5 * np.array(body.size), rotation, centers, half).min())
        case Sphere():
            return float(_point_distances(centers, half).min() - body.radius)
        case Capsule():
            return float(_segment_distances(0.5 * body.length * rotation[:, 2], centers, half).min() - body.cap_radius)


def _box_gaps(half_size: np.ndarray, rotation: np.ndarray, centers: np.ndarray, half: float) -> np.ndarray:
    crossed = np.cross(np.eye(3)[:, None], rotation.T[None]).reshape(9, 3)
    lengths = np.linalg.norm(crossed, axis=1)
    crossed = crossed[lengths > 1e-6] / lengths[lengths > 1e-6, None]
    axes = np.concatenate([np.eye(3), rotation.T, crossed])
    reach = np.abs(axes @ rotation) @ half_size + half * np.abs(axes).sum(1)
    return (np.abs(centers @ axes.T) - reach).max(1)


def _point_distances(centers: np.ndarray, half: float) -> np.ndarray:
    return np.linalg.norm(np.maximum(np.abs(centers) - half, 0.0), axis=-1)


def _segment_distances(tip: np.ndarray, centers: np.ndarray, half: float) -> np.ndarray:
    """Return distances to the segment from -tip to tip; they are convex along it, so ternary search finds the least."""
    low, high = np.full(len(centers), -1.0), np.ones(len(centers))
    for _ in range(80):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        nearer_left = _point_distances(centers - left[:, None] * tip, half) < _point_distances(
            centers - right[:, None] * tip, half
        )
        low, high = np.where(nearer_left, low, left), np.where(nearer_left, right, high)
    return _point_distances(centers - low[:, None] * tip, half)
