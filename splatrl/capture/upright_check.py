"""Check that images are upright: those that lie on their side or are upside down can be captured only by force."""

import math

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.cuts import takes
from splatrl.capture.ground import cameras_up, on_its_side, upside_down
from splatrl.capture.upright import ONE_WAY
from splatrl.capture.world import held_poses

Floats = NDArray[np.float64]

ROLLED, FEWEST = math.radians(60.0), 3
"""Roll of a take against the first one from which it counts as rotated, and the minimum number of its images."""
TAKE = (
    "the images of the take from {:.0f} s to {:.0f} s are rotated by {} turn against those of the first take: expected "
    "takes that are all upright. Rotate that film before you join them, or leave it out."
)

LIES = "images lie on their side: expected upright ones, got images rotated by a quarter turn. {}"
UPSIDE_DOWN = (
    "images are upside down: expected upright ones, got a camera that looks up on average, at a place mostly above "
    "it. {}"
)
FILM = (
    "Rotate the film in an editor, or with `ffmpeg -display_rotation 90 -i FILM -c copy TURNED.mp4` (or 270), and "
    "capture the result.",
    "Rotate the film with `ffmpeg -display_rotation 180 -i FILM -c copy TURNED.mp4`, and capture the result.",
)
"""What to do with a film that lies on its side, and with one that is upside down."""
PHOTOS = (
    "Rotate the photos by a quarter turn in an editor, and capture them again.",
    "Rotate the photos by half a turn in an editor, and capture them again.",
)
POSED = (
    "State their orientation in their EXIF, with `exiftool -n -Orientation=6 IMAGES` (or 8), and capture again: they "
    "are turned together with their poses.",
    "State their orientation in their EXIF, with `exiftool -n -Orientation=3 IMAGES` (8 in place of 6, 6 in place of "
    "8), and capture again: they are turned together with their poses.",
)
"""The same for the images of ``transforms.json`` and COLMAP models, whose poses hold for them as they are stored."""
UNTOLD = "Record the place again with a version of the app that records which way is up."


def why_not_upright(found: Reconstruction, photos: Photos) -> str | None:
    """Return how images are rotated, and what to do; None if they are upright.

    Args:
        found: a reconstruction in any frame.
        photos: the images that it was made from.
    """
    held = held_poses(found)
    if (rotated := _rotated_take(found, held)) is not None:
        return rotated
    if on_its_side(held):
        return LIES.format(_advice(photos)[0])
    return UPSIDE_DOWN.format(_advice(photos)[1]) if upside_down(held, found.points.numpy()) else None


def _rotated_take(found: Reconstruction, held: Floats) -> str | None:
    """Return which take of a film is rotated against its first one; None if none is.

    Where the first take looks one way, up may be off by its pitch, which looks like a roll of takes that look to other
    sides.
    """
    if found.seconds is None or not found.cuts:
        return None
    seconds = found.seconds.numpy()
    take = takes(seconds, found.cuts)
    up, _, lean = cameras_up(held[take == take[0]])
    if lean >= ONE_WAY:
        return None
    for number in np.unique(take)[1:]:
        rows = take == number
        right, own = held[rows, :3, 0] @ up, -held[rows, :3, 1] @ up
        roll = abs(math.atan2(float(right.mean()), float(own.mean())))
        if rows.sum() >= FEWEST and roll > ROLLED:
            by = "half a" if roll > math.pi - ROLLED else "a quarter"
            return TAKE.format(seconds[rows][0], seconds[rows][-1], by)
    return None


def _advice(photos: Photos) -> tuple[str, str]:
    if photos.camera_to_world is not None:
        return POSED if photos.files else (UNTOLD, UNTOLD)
    return PHOTOS if photos.files else FILM
