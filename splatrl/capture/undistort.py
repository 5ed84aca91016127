"""Removal of lens distortion from images, and what a camera without it sees of them."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from splatrl.capture.base import CaptureError, Reconstruction
from splatrl.capture.lens import Lens
from splatrl.capture.photo_files import read_photo
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.videos import shrunk
from splatrl.extras import require


def undistorted(
    paths: list[Path], lens: Lens, stages: Stages, name: str, progress: Progress = silent
) -> tuple[list[Path], Lens]:
    """Remove the lens distortion of images, so that a pinhole camera explains them, without black edges.

    Args:
        paths: the image files, all of the lens's size as they are stored, whatever the orientation in their EXIF.
        lens: their lens.
        stages: where the new images are kept.
        name: name of their folder there.
        progress: called for every image.

    Returns:
        Paths of the new images, numbered in the same order and of the same size, and their lens; the given ones where
        there is no distortion.

    Raises:
        CaptureError: for an image that cannot be read, or is of another size.
    """
    if not lens.bends:
        return paths, lens
    cv2: Any = require("cv2", "capture")
    size, camera = lens.size, lens.straight()
    names = [f"{number:04}.jpg" for number in range(len(paths))]

    def write(made: Path) -> None:
        maps = lens.maps(size, camera, size)
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

    key = fingerprint([size, lens.K(size).tolist(), lens.distortion, lens.fisheye], files=paths)
    kept = stages.folder(name, key, write)
    return [kept / name for name in names], camera


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
    maps = lens.maps(image.size, camera, (fine * size[0], fine * size[1]))
    seen = cv2.remap(np.asarray(image), *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return Image.fromarray(seen).resize(size, Image.Resampling.BICUBIC)


def distorted(masks: NDArray[np.bool_], found: Reconstruction) -> NDArray[np.bool_]:
    """Return masks of images without lens distortion as masks of the photos that they were made from.

    Args:
        masks: [N, h, w], of any size.
        found: the reconstruction with these images.

    Returns:
        [N, h, w]; beyond the edge of the images without distortion, what is at that edge.
    """
    if found.lens is None:
        return masks
    height, width = masks.shape[1:]
    scale = np.array(found.lens.size) / (width, height)
    places = (np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) + 0.5) * scale
    straight = found.lens.straightened(places.reshape(-1, 2)) * found.K.diagonal()[:2].numpy() + found.K[:2, 2].numpy()
    column, line = np.floor(straight.reshape(height, width, 2) / scale).astype(int).transpose(2, 0, 1)
    return masks[:, line.clip(0, height - 1), column.clip(0, width - 1)]
