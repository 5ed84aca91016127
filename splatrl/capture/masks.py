"""Masks of what moved, with which poses are found again where it filled much of the images.

Whoever walks ahead of the camera through a whole film is in nearly all of its images, and points on them bend the
camera's path. Most of them are found with these first poses all the same (see ``moving``), since these bend slowly, and
more of them with better ones.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from torch import Tensor

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.fitting.fit import held_out
from splatrl.capture.undistort import distorted

MUCH, MORE = 0.03, 0.01
"""Minimum fraction of the photos' pixels that must show moving things for poses to be found again without them, and of
those that were not masked before for poses to be found once more."""
GROWN = 2
"""Pixels of the depth maps by which masks are grown: features at the edge of a thing show it, too."""

Masks = NDArray[np.bool_]


def much_moves(moving: Tensor) -> bool:
    """Return whether so much moved in photos, given as [N, H, W] bool, that it may have bent their poses."""
    return float(moving.float().mean()) >= MUCH


def masks_of(moving: Tensor, found: Reconstruction, photos: Photos) -> Masks | None:
    """Return where photos showed moving things, by this search and those before; None where it found little more.

    Nothing is known of photos without a pose. In images of a film that are held out, and in which nothing was sought,
    whatever moved is taken to be wherever it was in the image before or after.

    Args:
        moving: [N, h, w] bool, where images of the reconstruction show moving things.
        found: the reconstruction.
        photos: the photos that it was made from, with the masks that were used for it.

    Returns:
        [P, h, w], for each of the photos.
    """
    assert found.numbers is not None
    if not much_moves(moving):
        return None
    pixels = moving.numpy().copy()
    if found.seconds is not None:
        for row in held_out(len(pixels)).tolist():
            pixels[row] = pixels[max(row - 1, 0)] | pixels[min(row + 1, len(pixels) - 1)]
    grown = ndimage.binary_dilation(pixels, np.ones((1, 3, 3)), iterations=GROWN)
    shown = np.zeros((len(photos.paths), *pixels.shape[1:]), bool)
    shown[found.numbers.numpy()] = distorted(grown, found)
    if photos.moving is None:
        return shown
    height, width = shown.shape[1:]
    images = [Image.open(path).resize((width, height), Image.Resampling.NEAREST) for path in _files(photos)]
    before = np.stack([np.asarray(image) == 0 for image in images])
    return shown | before if (shown & ~before).mean() >= MORE else None


def write_masks(folder: Path, masks: Masks, photos: Photos) -> None:
    """Write a mask [h, w] for each photo to a folder, named like it and ``.png`` after it, black where it is true."""
    for path, black in zip(_files(replace(photos, moving=folder)), masks, strict=True):
        image = Image.fromarray(np.uint8(255) * ~black)
        image.resize((photos.width, photos.height), Image.Resampling.NEAREST).save(path)


def in_view(folder: Path) -> float | None:
    """Return the fraction of the photos whose masks in this folder show something; None where it has no masks."""
    masks = sorted(folder.glob("*.png"))
    return float(np.mean([Image.open(mask).getextrema()[0] == 0 for mask in masks])) if masks else None


def _files(photos: Photos) -> list[Path]:
    """Return the photos' masks."""
    assert photos.moving is not None
    return [photos.moving / f"{path.name}.png" for path in photos.paths]
