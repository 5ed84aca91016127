"""By how many quarter turns each image is rotated: a phone may be turned while it films, or photos to one size."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.base import Reconstruction
from splatrl.capture.held import cameras_up

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COUNT = 3000
"""Number of directions among which up is sought, 4° apart: quarter turns need it no more exactly."""
ALIKE = (1.3, 0.01)
"""Factor and addend, radians, up to which the roll of the images about another up is no larger than about the best."""
FIRST, PREFERRED = 0.1, 0.75
"""Fraction of the images that come first, and how much more these count than the rest for the choice between such
directions: a phone records which way it is held as a film begins."""
FEW = 0.05
"""Minimum fraction of the images that are rotated, and of those that are not."""
BETTER, CLEARLY = 1.2, 2.0
"""Minimum ratio of the mean tilt that images have if none is rotated to the mean roll that is left of them once quarter
turns are undone, and the ratio from which no doubt remains. Without a turn it is 0.2 at most, or 1 where the camera
sways by 45°."""
DOWNWARDS = 4.0
"""Ratio of the height of the images' own up axes to that tilt, below which a camera that was not turned would have
looked straight down or been held askew. Cameras that look down by 75° have 25 or more."""


class Quarters(NamedTuple):
    """Quarter turns of images.

    Attributes:
        each: [N] number of quarter turns, 0 to 3, by which each image is rotated clockwise.
        sure: False where the camera may instead have looked straight down, and turned to another side.
    """

    each: Ints
    sure: bool = True

    def undone(self, camera_to_world: Floats) -> Floats:
        """Return the poses [N, 4, 4] that the cameras would have if their images were upright."""
        poses = camera_to_world.copy()
        right, down = (camera_to_world[:, :3, axis] for axis in (0, 1))
        cos, sin = (np.round(part(0.5 * math.pi * self.each))[:, None] for part in (np.cos, np.sin))
        poses[:, :3, 0], poses[:, :3, 1] = cos * right + sin * down, cos * down - sin * right
        return poses


def quarters(found: Reconstruction) -> Quarters:
    """Return by how many quarter turns the photos that were turned to one size are rotated, or the images of a film."""
    if found.turned is not None:
        return Quarters(found.turned.numpy().astype(np.int64))
    if found.seconds is None:
        return Quarters(np.zeros(len(found.paths), np.int64))
    return turned_while_filming(found.camera_to_world.numpy())


def held_poses(found: Reconstruction) -> Floats:
    """Return the poses [N, 4, 4] of the cameras as they were held, without the ``quarters`` of their images."""
    return quarters(found).undone(found.camera_to_world.numpy())


def turned_while_filming(camera_to_world: Floats) -> Quarters:
    """Find the images of a film in which the camera was held turned by one or more quarters.

    People hold a camera so that one axis of its image is level. So up is a direction about which all images are rolled
    by nearly whole quarters; of several, the one that lies upwards in the first images and in most. The images count as
    upright unless quarter turns explain them better.

    A camera that looks one way and is turned by a quarter has the axes of one that looks straight down and turns to
    another side. It is taken for the former, and not sure.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes, in any frame, in the order in which the images were taken.
    """
    right, own = camera_to_world[:, :3, 0], -camera_to_world[:, :3, 1]
    upwards = own @ _DIRECTIONS.T
    rolls = np.arctan2(right @ _DIRECTIONS.T, upwards)
    turns = np.round(rolls / (0.5 * math.pi)).astype(np.int64)
    off = np.abs(rolls - 0.5 * math.pi * turns).mean(0)
    likely = np.flatnonzero(off <= ALIKE[0] * off.min() + ALIKE[1])
    upright = upwards.mean(0) + PREFERRED * upwards[: math.ceil(FIRST * len(upwards))].mean(0)
    best = likely[upright[likely].argmax()]
    each, unturned = turns[:, best] % 4, Quarters(np.zeros(len(turns), np.int64))
    if not FEW <= (each == 0).mean() <= 1 - FEW:
        return unturned
    up = cameras_up(camera_to_world).up
    tilt = float(np.maximum(np.abs(right @ up), -(own @ up)).mean())
    if tilt >= CLEARLY * off[best]:
        return Quarters(each)
    if np.abs(own @ up).mean() < DOWNWARDS * tilt and (each == 2).mean() < FEW:
        return Quarters(each, sure=False)
    return Quarters(each) if tilt >= BETTER * off[best] else unturned


def how_turned(found: Reconstruction) -> str | None:
    """Return when the camera of a film was turned, as a sentence for the report; None if it never was."""
    each, sure = quarters(found)
    if found.seconds is None or not each.any():
        return None
    when = float(found.seconds[int((each != each[0]).argmax())])
    if sure:
        return (
            f"The camera was turned on its side or upside down while it filmed, first at {when:.0f} s; up allows for "
            "that."
        )
    return (
        f"The camera seems to have been turned on its side at {when:.0f} s while it filmed. If it looked straight down "
        "instead, up is wrong. Hold it one way throughout the film, and look around more."
    )


def _sphere(count: int) -> Floats:
    """Return directions spread evenly over the sphere, by a Fibonacci spiral: [count, 3]."""
    place = np.arange(count) + 0.5
    z, yaw = 1.0 - 2.0 * place / count, math.pi * (1.0 + math.sqrt(5.0)) * place
    wide = np.sqrt(1.0 - z**2)
    return np.stack([wide * np.cos(yaw), wide * np.sin(yaw), z], 1)


_DIRECTIONS = _sphere(COUNT)
