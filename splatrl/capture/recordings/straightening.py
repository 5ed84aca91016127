"""What a camera without lens distortion sees of images with it, for recordings where each image has its own lens."""

from typing import Any

import numpy as np
from PIL import Image

from splatrl.capture.recordings.base import Floats, Lens
from splatrl.capture.videos import shrunk
from splatrl.extras import require


def straight(lens: Lens) -> Lens:
    """Return the lens without distortion whose image, of the same size, shows as much as the given one can fill."""
    if not any(lens.distortion):
        return lens
    cv2: Any = require("cv2", "capture")
    size = round(lens.width), round(lens.height)
    new, _ = cv2.getOptimalNewCameraMatrix(_matrix(lens, size), np.array(lens.distortion), size, 0, size)
    return Lens(lens.width, lens.height, new[0, 0], new[1, 1], new[0, 2] + 0.5, new[1, 2] + 0.5)


def folds(lens: Lens, camera: Lens) -> bool:
    """Return whether distortion maps different directions that a camera without it sees to one pixel of a lens."""
    k1, k2, _, _, k3 = lens.distortion
    corner = np.hypot(
        max(camera.cx, camera.width - camera.cx) / camera.fx, max(camera.cy, camera.height - camera.cy) / camera.fy
    )
    r2 = np.linspace(0.0, corner, 101) ** 2
    return bool((1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) <= 0.0).any())


def seen_by(camera: Lens, image: Image.Image, lens: Lens, size: tuple[int, int]) -> Image.Image:
    """Return what a camera in the same place sees of an image.

    Args:
        camera: a camera without distortion that sees no more than the image shows.
        image: the image, RGB, of any scale.
        lens: the lens of the image.
        size: width and height of the result, pixels.
    """
    cv2: Any = require("cv2", "capture")
    fine = 1
    if image.width > 1.5 * size[0]:  # remapping alone does not smooth
        fine, image = 2, shrunk(image, 2 * max(size))
    large = fine * size[0], fine * size[1]
    maps = cv2.initUndistortRectifyMap(
        _matrix(lens, image.size), np.array(lens.distortion), None, _matrix(camera, large), large, cv2.CV_16SC2
    )
    seen = cv2.remap(np.asarray(image), *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return Image.fromarray(seen).resize(size, Image.Resampling.BICUBIC)


def _matrix(lens: Lens, size: tuple[int, int]) -> Floats:
    """Return a lens's K [3, 3] for images of a size, with the centre of the first pixel at 0, as OpenCV has it."""
    across, down = size[0] / lens.width, size[1] / lens.height
    return np.array(
        [[lens.fx * across, 0, lens.cx * across - 0.5], [0, lens.fy * down, lens.cy * down - 0.5], [0, 0, 1]]
    )
