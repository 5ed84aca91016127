"""Removal of lens distortion from images."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.photo_files import read_photo
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stages import Stages, fingerprint
from splatrl.extras import require

WIDEST = 60.0
"""Maximum angle beside a fisheye's axis, horizontally or vertically, that is kept, degrees: farther out, a straight
image magnifies the lens's pixels more than fourfold, at the expense of its middle."""
STEEPEST = 89.0
"""Maximum angle from a fisheye's axis, degrees; what is farther off counts as at this angle."""


def undistorted(
    paths: list[Path],
    size: tuple[int, int],
    K: Tensor,
    distortion: np.ndarray,
    stages: Stages,
    name: str,
    progress: Progress = silent,
    fisheye: bool = False,
) -> tuple[list[Path], Tensor]:
    """Remove the lens distortion of images, so that a pinhole camera explains them, without black edges.

    Args:
        paths: the image files, all of one size as they are stored, whatever the orientation in their EXIF.
        size: width and height, pixels.
        K: [3, 3] float64 intrinsics, pixels, with the centre of the first pixel at (0.5, 0.5).
        distortion: OpenCV's k1, k2, p1, p2 (and more), or of a fisheye k1, k2, k3, k4.
        stages: where the new images are kept.
        name: name of their folder there.
        progress: called for every image.
        fisheye: whether the lens is a fisheye. What is more than ``WIDEST`` beside its axis is cut off.

    Returns:
        Paths of the new images, numbered in the same order and of the same size, and their K [3, 3] float64; the given
        ones where there is no distortion.

    Raises:
        CaptureError: for an image that cannot be read, or is of another size.
    """
    cv2 = require("cv2", "capture")
    if not (fisheye or np.any(distortion)):
        return paths, K
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV has the centre of the first pixel at 0
    given = K.numpy() - half
    new = _inside(given, distortion, size) if fisheye else cv2.getOptimalNewCameraMatrix(given, distortion, size, 0)[0]
    lens = cv2.fisheye if fisheye else cv2
    names = [f"{number:04}.jpg" for number in range(len(paths))]

    def write(made: Path) -> None:
        maps = lens.initUndistortRectifyMap(given, distortion, np.eye(3), new, size, cv2.CV_16SC2)
        for number, (path, name) in enumerate(zip(paths, names, strict=True)):
            progress("undistort", number, len(paths))
            image = read_photo(path, upright=False)
            if image.size != size:
                raise CaptureError(
                    f"{path}: expected {size[0]} × {size[1]} pixels, got {image.size[0]} × {image.size[1]}"
                )
            bgr = np.ascontiguousarray(np.asarray(image)[..., ::-1])
            straight = cv2.remap(bgr, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            if not cv2.imwrite(str(made / name), straight, [cv2.IMWRITE_JPEG_QUALITY, 95]):
                raise OSError(f"{made / name}: cannot write the undistorted image")
        progress("undistort", len(paths), len(paths))

    key = fingerprint([size, K.tolist(), list(distortion), fisheye], files=paths)
    kept = stages.folder(name, key, write)
    return [kept / name for name in names], torch.from_numpy(new + half)


def distorted(masks: NDArray[np.bool_], size: tuple[int, int], found: Reconstruction) -> NDArray[np.bool_]:
    """Return masks of images without lens distortion as masks of the photos that they were made from.

    Args:
        masks: [N, h, w], of any size.
        size: width and height of the photos, pixels.
        found: the reconstruction with these images.

    Returns:
        [N, h, w]; beyond the edge of the images without distortion, what is at that edge.
    """
    if found.camera is None:
        return masks
    cv2 = require("cv2", "capture")
    height, width = masks.shape[1:]
    scale = np.array(size) / (width, height)
    places = (np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) + 0.5) * scale
    fx, fy, cx, cy, *distortion = found.camera.tolist()
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if found.fisheye:
        rays = _rays(places.reshape(-1, 2), K, np.array(distortion))
        straight = rays * found.K.diagonal()[:2].numpy() + found.K[:2, 2].numpy()
    else:
        straight = cv2.undistortPoints(places.reshape(-1, 1, 2), K, np.array(distortion), P=found.K.numpy())
    column, line = np.floor(straight.reshape(height, width, 2) / scale).astype(int).transpose(2, 0, 1)
    return masks[:, line.clip(0, height - 1), column.clip(0, width - 1)]


def _rays(pixels: NDArray[np.float64], K: NDArray[np.float64], distortion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a fisheye's pixels [N, 2] are in a straight image of focal length 1: [N, 2].

    Args:
        pixels: places in the fisheye's image.
        K: [3, 3] its intrinsics, in the same pixels.
        distortion: OpenCV's k1, k2, k3, k4.
    """
    angles = np.linspace(0.0, np.radians(STEEPEST), 4096)
    radii = angles * (1.0 + sum(k * angles ** (2 * power) for power, k in enumerate(distortion.tolist(), 1)))
    outermost = int(radii.argmax()) + 1  # beyond, coefficients describe no lens
    offsets = (pixels - K[:2, 2]) / K.diagonal()[:2]
    radius = np.linalg.norm(offsets, axis=1, keepdims=True)
    return offsets / np.maximum(radius, 1e-12) * np.tan(np.interp(radius, radii[:outermost], angles[:outermost]))


def _inside(K: NDArray[np.float64], distortion: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return the intrinsics [3, 3] of a straight image of the same size that a fisheye's image fills to the edges.

    Args:
        K: [3, 3] intrinsics of the fisheye, with the centre of the first pixel at 0.
        distortion: OpenCV's k1, k2, k3, k4.
        size: width and height, pixels.
    """
    last, new = np.array(size) - 1.0, np.eye(3)
    along = np.linspace(0.0, 1.0, 101)
    for axis in (0, 1):
        ends = []
        for edge in (0.0, last[axis]):
            places = along[:, None] * last
            places[:, axis] = edge
            ends.append(np.abs(_rays(places, K, distortion)[:, axis]).min())
        low, high = np.minimum(ends, np.tan(np.radians(WIDEST)))
        new[axis, axis] = last[axis] / (low + high)
        new[axis, 2] = low * new[axis, axis]
    return new
