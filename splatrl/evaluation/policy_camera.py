"""A policy's camera, as which the images of any other camera are shown to the policy."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

ROUNDING = 0.1
"""Fraction of a policy's pixel by which an image may fall short of it and still show it."""


@dataclass(frozen=True)
class Eye:
    """A policy's camera, and what it would see of the images of another camera that is in its place.

    Attributes:
        height: height of the policy's image, pixels.
        width: width of the policy's image, pixels.
        views: number of successive images that the policy sees at once.
        fov_deg: horizontal field of view of the policy's camera, degrees.
        film_fov_deg: horizontal field of view of the other camera, degrees; None takes that of the policy's.
    """

    height: int
    width: int
    views: int = 1
    fov_deg: float = 90.0
    film_fov_deg: float | None = None

    def fitted(self, image: Image.Image) -> Tensor:
        """Resize an image by area averaging, so that each pixel covers the angle that it covers in the policy's camera.

        What the policy's camera would not see is cropped. Rows and columns that the image does not show in full repeat
        the nearest that it does.

        Args:
            image: RGB image of any size.

        Returns:
            [height, width, 3] uint8.
        """
        scale = self._scale(image)
        across, down = _shares(image.width, self.width, scale), _shares(image.height, self.height, scale)
        columns = _seen(across.sum(0))
        pixels, lines = np.asarray(image)[:, columns], []
        for shares in down:  # one row of the result at a time, so that a large image is never held as floats
            rows = _seen(shares)
            lines.append(np.tensordot(shares[rows], pixels[rows], 1))
        means = np.tensordot(across[:, columns], np.stack(lines), (1, 1)).swapaxes(0, 1)
        beyond = (self.height - len(down)) // 2, (self.width - len(across)) // 2
        shown = np.pad(means, [(side, side) for side in (*beyond, 0)], "edge")
        return torch.from_numpy(np.floor(shown + 0.5).astype(np.uint8))

    def note(self, image: Image.Image) -> str:
        """Say which part of the policy's field of view an image shows; empty if it shows all of it."""
        scale, focal = self._scale(image), 0.5 * self.width / _half_width(self.fov_deg)
        sides = ((image.width, self.width), (image.height, self.height))
        if not any(_beyond(length, count, scale) for length, count in sides):
            return ""
        shown = [_angle(min(length / scale, count), focal) for length, count in sides]
        wanted = [_angle(count, focal) for _, count in sides]
        taken = (
            "" if self.film_fov_deg else f" if it spans {self.fov_deg:g}° across, as the policy's camera does (fov=)"
        )
        return (
            f"shows {shown[0]:.0f}° × {shown[1]:.0f}° of the policy's {wanted[0]:.0f}° × {wanted[1]:.0f}°{taken}; "
            f"its edges are repeated beyond"
        )

    def _scale(self, image: Image.Image) -> float:
        """Return the number of an image's pixels along a side of a pixel of the policy."""
        own, given = (_half_width(fov) for fov in (self.fov_deg, self.film_fov_deg or self.fov_deg))
        return image.width * own / given / self.width


def _half_width(fov_deg: float) -> float:
    """Return half the width of an image at distance 1 from the camera."""
    return math.tan(math.radians(fov_deg) / 2)


def _angle(pixels: float, focal: float) -> float:
    """Return the angle that a centred row of pixels covers, degrees."""
    return math.degrees(2 * math.atan(0.5 * pixels / focal))


def _seen(weights: NDArray[np.float64]) -> slice:
    """Return the range outside of which all weights are 0."""
    first, last = np.flatnonzero(weights)[[0, -1]]
    return slice(first, last + 1)


def _shares(length: int, count: int, scale: float) -> NDArray[np.float64]:
    """Return the weight of each of ``length`` pixels in the mean over those of ``count`` cells that they show.

    The cells are ``scale`` pixels wide, in a row centred on the pixels; a pixel's weight is proportional to its overlap
    with the cell. As many cells at either end are left out as reach beyond the pixels.

    Returns:
        [at most count, length] weights, whose rows sum to 1.
    """
    beyond = _beyond(length, count, scale)
    cells = np.arange(beyond, count - beyond)
    edges = 0.5 * length + scale * (cells[:, None] + [0, 1] - 0.5 * count)
    pixels = np.arange(length)
    overlap = np.minimum(edges[:, 1:], pixels + 1) - np.maximum(edges[:, :1], pixels)
    overlap = np.maximum(overlap, 0.0)
    shares: NDArray[np.float64] = overlap / overlap.sum(1, keepdims=True)
    return shares


def _beyond(length: int, count: int, scale: float) -> int:
    """Return how many of ``count`` centred cells reach beyond ``length`` pixels at either end; one always stays."""
    return min(max(math.ceil(0.5 * (count - length / scale) - ROUNDING), 0), (count - 1) // 2)
