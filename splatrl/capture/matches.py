"""Features of small images, and how two of these images are related: fast enough for a look before the real work."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from splatrl.capture.unchanging import left_out
from splatrl.extras import require

LONGEST, FEATURES = 640, 1500
CONTRAST, FEW, FAINT = 0.02, 400, 0.005
"""Minimum contrast of a distinct point; the number of distinct points below which an image is searched again for
fainter ones, as ``structure`` does; and the minimum contrast of those."""
MIN_INLIERS = 15
GUESSED_FOCAL = 1.2
"""Focal length relative to the longer side: COLMAP's guess where nothing is known."""
SAME_CENTRE = 0.03
"""Limit of √(σ₁/σ₃) − 1, at the best focal length, below which a homography counts as a rotation's; it is about the
sideways movement as a fraction of the distance."""


@dataclass(frozen=True)
class Features:
    """Features of one image.

    Attributes:
        points: [N, 2] float64, pixels.
        descriptors: [N, 128] float32, unit vectors.
        distinct: number of points with the contrast of a distinct one.
        brightness: mean grey level where features are sought, 0 to 255; of the whole image where none are.
        size: width and height, pixels.
    """

    points: np.ndarray
    descriptors: np.ndarray
    distinct: int
    brightness: float
    size: tuple[int, int]


@dataclass(frozen=True)
class Pair:
    """How two images are related.

    Attributes:
        kind: ``none`` without enough common points, ``turned`` where a rotation about the camera's centre explains
            them, ``plane`` where a moving camera saw a plane, ``moved`` otherwise.
        angle: median angle between the rays to a point, radians; 0 unless the camera moved.
        shift: median displacement of a point in the image, as a fraction of the longer side.
    """

    kind: Literal["none", "turned", "plane", "moved"]
    angle: float = 0.0
    shift: float = 0.0


def features(path: Path, mask: Path | None = None) -> Features:
    """Extract the SIFT features of an image, scaled down to at most 640 pixels in width and height.

    Descriptors are the square roots of L1-normalised ones.

    Args:
        path: the image file.
        mask: image of the same size, black where no features are sought; None to seek them everywhere.
    """
    cv2 = require("cv2", "capture")
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise ValueError(f"{path}: expected an image, got an unreadable file")
    sought = None if mask is None else np.uint8(255) * ~left_out(mask)
    brightness = float(grey.mean() if sought is None or not sought.any() else grey[sought > 0].mean())
    scale = LONGEST / max(grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        sought = None if sought is None else cv2.resize(sought, grey.shape[::-1], interpolation=cv2.INTER_NEAREST)
    keypoints, descriptors = cv2.SIFT_create(FEATURES, contrastThreshold=CONTRAST).detectAndCompute(grey, sought)
    distinct, size = len(keypoints), (grey.shape[1], grey.shape[0])
    if distinct < FEW:
        keypoints, descriptors = cv2.SIFT_create(FEATURES, contrastThreshold=FAINT).detectAndCompute(grey, sought)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), 0, brightness, size)
    points = np.array([keypoint.pt for keypoint in keypoints]).reshape(-1, 2) + 0.5
    descriptors = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))
    return Features(points, descriptors, distinct, brightness, size)


def matches(a: Features, b: Features) -> np.ndarray:
    """Match descriptors that are mutual nearest neighbours, and clearly nearer than the second nearest.

    Args:
        a: features of one image.
        b: features of the other.

    Returns:
        [M, 2] uint32, indices of points of a and of b.
    """
    if min(len(a.points), len(b.points)) < 2:
        return np.zeros((0, 2), np.uint32)
    likeness = a.descriptors @ b.descriptors.T
    forth, good_forth = _nearest(likeness)
    back, good_back = _nearest(np.ascontiguousarray(likeness.T))
    rows = np.arange(len(forth))
    chosen = good_forth & good_back[forth] & (back[forth] == rows)
    return np.stack([rows[chosen], forth[chosen]], 1).astype(np.uint32)


def related(a: Features, b: Features) -> Pair:
    """Find out how two images are related, without knowing the camera.

    Args:
        a: features of one image.
        b: features of the other, of the same size.
    """
    pycolmap = require("pycolmap", "capture")
    found = matches(a, b)
    if len(found) < MIN_INLIERS:
        return Pair("none")
    width, height = a.size
    focal = GUESSED_FOCAL * max(a.size)
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=[focal, width / 2, height / 2])
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
    options.ransac.random_seed = 0
    options.ransac.max_num_trials = 2000
    geometry = pycolmap.estimate_two_view_geometry(camera, a.points, camera, b.points, found, options)
    inliers = np.asarray(geometry.inlier_matches)
    if len(inliers) < MIN_INLIERS:
        return Pair("none")
    ways = a.points[inliers[:, 0]] - b.points[inliers[:, 1]]
    shift = float(np.median(np.linalg.norm(ways, axis=1))) / max(a.size)
    kind = pycolmap.TwoViewGeometryConfiguration(geometry.config).name
    if kind == "PANORAMIC" or (kind in ("PLANAR", "PLANAR_OR_PANORAMIC", "WATERMARK") and _turned(geometry, a.size)):
        return Pair("turned", 0.0, shift)
    return Pair("plane" if kind.startswith("PLANAR") else "moved", float(geometry.tri_angle), shift)


def _turned(geometry: Any, size: tuple[int, int]) -> bool:
    """Return whether the homography of two images fits a camera that only turned, for any likely focal length."""
    if geometry.H is None:
        return True
    return unlike_rotation(np.asarray(geometry.H), size) < SAME_CENTRE


def unlike_rotation(homography: np.ndarray, size: tuple[int, int]) -> float:
    """Return how far a homography is from K R K⁻¹, with any rotation R and any likely focal length.

    Args:
        homography: [3, 3] in pixels.
        size: width and height, pixels.

    Returns:
        √(σ₁/σ₃) − 1 of K⁻¹ H K, 0 for a rotation.
    """
    focals = max(size) * np.geomspace(0.4, 1.5, 20)
    K = np.zeros((len(focals), 3, 3))
    K[:, 0, 0] = K[:, 1, 1] = focals
    K[:, 0, 2], K[:, 1, 2], K[:, 2, 2] = size[0] / 2, size[1] / 2, 1
    values = np.linalg.svd(np.linalg.inv(K) @ homography @ K, compute_uv=False)
    return float(np.sqrt(values[:, 0] / np.maximum(values[:, 2], 1e-12)).min()) - 1


def _nearest(likeness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest column of each row, and whether it is near and unambiguous."""
    rows = np.arange(len(likeness))
    nearest = likeness.argmax(1)
    first = likeness[rows, nearest]
    likeness[rows, nearest] = -1
    second = likeness.max(1)
    likeness[rows, nearest] = first
    first_angle, second_angle = (np.arccos(np.clip(value, -1, 1)) for value in (first, second))
    return nearest, (first_angle < 0.7) & (first_angle < 0.8 * second_angle)
