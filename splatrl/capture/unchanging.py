"""Parts of the image that never change: the robot that carries the camera, a finger, dirt, or writing over a film.

They move with the camera, so that a map with them is bent, and a scene has them floating in it. What is uniform never
changes either, such as a bare wall in every image; so edges decide, which stay in place and of one strength only where
they belong to the camera, and what is far from them stays.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from torch import Tensor

from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stages import Stages, fingerprint
from splatrl.images import read_photo

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

MASK = "mask.png"
LONGEST, IMAGES, FEWEST = 240, 100, 10
"""Longer side of the images that are compared, pixels; their maximum and their minimum number."""
ALWAYS = 0.95
"""Minimum fraction of the images in which a pixel must be the same."""
EDGE, STRENGTH = 3.0, 0.5
"""Minimum strength of an edge, grey levels per pixel, and how far it may deviate from its median, relative to that."""
SAME = 6.0
"""Maximum deviation of a pixel from its median, grey levels, apart from the image's brightness."""
EDGES = 0.02
"""Minimum fraction of a part's pixels that must be edges which never change."""
LEAST, MOST = 0.003, 0.5
"""Fraction of the image from which parts are left out, and from which too little of it is left."""
REACH = 16
"""Maximum distance of a pixel from an edge that never changes, pixels at ``LONGEST``: a bare floor may begin where the
deck ends, and only edges tell them apart."""
GROWN = 3
"""Pixels, at ``LONGEST``, by which parts are grown: features next to them would show both."""
LINE, BESIDE = 24, 28
"""Maximum height of a part that may be a line or two of writing, if it is no higher than wide, and what is left out to
either side of it, pixels at ``LONGEST``: the digits of a clock change."""


def with_mask(photos: Photos, folder: Path, progress: Progress = silent) -> Photos:
    """Return photos with a mask of what never changes in them, which is found once and kept; without, if all changes.

    Photos that were turned to one size, fewer than ``FEWEST``, and those whose poses are known get none.

    Args:
        photos: photos of one place.
        folder: the capture's folder; the mask is written to its sub-folder ``unchanging``.
        progress: called for every image that is read.
    """
    if len(photos.paths) < FEWEST or photos.turned is not None or photos.camera_to_world is not None:
        return photos

    def write(made: Path) -> None:
        found = unchanging(_greys(photos.paths, progress))
        if found.mean() < LEAST:
            found[:] = False
        found = with_lines(found)
        size = photos.width, photos.height
        Image.fromarray(np.uint8(255) * ~found).resize(size, Image.Resampling.NEAREST).save(made / MASK)

    kept = Stages(folder).folder("unchanging", fingerprint([LONGEST, LINE, BESIDE], files=photos.paths), write) / MASK
    return replace(photos, mask=kept if left_out(kept).any() else None)


def unchanging(greys: Floats) -> Mask:
    """Return which pixels never change, [H, W].

    Args:
        greys: [N, H, W] grey levels, 0 to 255.
    """
    usual = np.median(greys, 0)
    edges = np.stack([ndimage.sobel(greys, axis=axis) for axis in (1, 2)], -1) / 8
    edge = np.median(edges, 0)
    strength = np.linalg.norm(edge, axis=-1)
    off = np.linalg.norm(edges - edge, axis=-1)
    stays: Mask = (strength >= EDGE) & ((off <= STRENGTH * strength).mean(0) >= ALWAYS)
    if not stays.any():
        return stays
    gains = np.median(greys[:, stays] / np.maximum(usual[stays], 1.0), 1)
    same = (np.abs(greys - gains[:, None, None] * usual) <= SAME).mean(0) >= ALWAYS
    near = ndimage.distance_transform_edt(~stays) <= REACH
    parts, count = ndimage.label(ndimage.binary_closing((same | stays) & near))
    each = np.arange(1, count + 1)
    found: Mask = np.isin(parts, each[ndimage.mean(stays, parts, each) >= EDGES])
    return ndimage.binary_dilation(found, iterations=GROWN) if found.any() else found


def with_lines(found: Mask) -> Mask:
    """Return what never changes, [H, W], with what is beside low parts of it: the rest of a line of writing."""
    lines = found.copy()
    for rows, columns in ndimage.find_objects(ndimage.label(found)[0]):
        if rows.stop - rows.start <= min(LINE, columns.stop - columns.start):
            lines[rows, max(0, columns.start - BESIDE) : columns.stop + BESIDE] = True
    return lines


def left_out(mask: Path) -> Mask:
    """Return which pixels a mask leaves out, [H, W].

    Raises:
        CaptureError: for a mask that cannot be read.
    """
    try:
        dark: Mask = np.asarray(read_photo(mask).convert("L")) < 128
    except (OSError, ValueError) as error:
        raise CaptureError(f"{mask}: expected an image, got {error}") from error
    return dark


def left_out_at(found: Reconstruction, height: int, width: int) -> Tensor | None:
    """Return which pixels of images of another size are left out because they never change, [height, width] bool.

    Args:
        found: a reconstruction.
        height: height of these images, pixels.
        width: width of these images, pixels.

    Returns:
        None where none are.
    """
    if found.mask is None:
        return None
    whole = Image.fromarray(np.uint8(255) * left_out(found.mask))
    return torch.from_numpy(np.asarray(whole.resize((width, height), Image.Resampling.BOX)) > 0)


def said(mask: Path) -> str:
    """Return a remark for the report: how much of the image a mask leaves out, and where."""
    dark = left_out(mask)
    where = _where(dark)
    percent = 100 * dark.mean()
    hides = " If it hides the floor, a table may be taken for that: set the scale by a marker or a distance."
    return (
        f"{percent:.{0 if percent >= 10 else 1}f} % of the image, {where}, never changes, like the body of a "
        f"robot that carries the camera, and is left out.{hides if 'bottom' in where else ''}"
    )


def too_much(mask: Path) -> str | None:
    """Return why a capture cannot work with so much of the image left out; None where enough remains."""
    dark = left_out(mask)
    if dark.mean() < MOST:
        return None
    return (
        f"{100 * dark.mean():.0f} % of the image, {_where(dark)}, never changes, but less than {100 * MOST:.0f} % may: "
        "the camera sees too much of what carries it, or stood still. Turn or raise it so that it sees the place."
    )


def _where(dark: Mask) -> str:
    """Return where in the image most of some pixels are, in words."""
    middle = ndimage.center_of_mass(dark)
    thirds = [min(2, int(3 * place / side)) for place, side in zip(middle, dark.shape, strict=True)]
    words = [("top", "", "bottom")[thirds[0]], ("left", "", "right")[thirds[1]]]
    if any(words):
        return f"mostly at the {' '.join(filter(None, words))}"
    return "mostly around its middle" if dark[tuple(map(int, middle))] else "mostly along its edges"


def _greys(paths: list[Path], progress: Progress) -> Floats:
    rows = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), IMAGES)).round().astype(int)).tolist()
    greys: list[NDArray[np.float32]] = []
    for done, row in enumerate(rows):
        progress("unchanging", done, len(rows))
        image = read_photo(paths[row]).convert("L")
        image.thumbnail((LONGEST, LONGEST), Image.Resampling.BOX)
        greys.append(np.asarray(image, np.float32))
    progress("unchanging", len(rows), len(rows))
    return np.stack(greys)
