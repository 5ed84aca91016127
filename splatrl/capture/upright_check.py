"""Check that images are upright: those that lie on their side or are upside down can be captured only by force."""

import math

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.ground import upside_down
from splatrl.capture.held import RISES, if_steeply_down, looks_up, on_its_side, share_along, sweeps
from splatrl.capture.quarters import held_poses

Floats = NDArray[np.float64]

MOSTLY_ABOVE = 0.6
"""Minimum fraction of the points above cameras that look up, for a doubt that these are upside down; in trials, all
that looked down by 8° or more and were turned over had more. So may upright ones that look up by 10°."""

RISEN = 0.15
"""Minimum extent of a path along up (standard deviation), relative to the distance of most points, for it to say
anything about up: who turns on one spot sways all ways."""
HALF_WAY = math.sqrt(0.5)
"""Cosine above which up is nearer to one of two perpendicular directions."""

LIES = "images lie on their side: expected upright ones, got images rotated by a quarter turn. {}"
UPSIDE_DOWN = (
    "images seem to be upside down: expected upright ones, got a camera that looks up on average, at a place mostly "
    "above it with a floor or ceiling up there. {}"
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
SWEPT = (
    "Up may be wrong by a quarter turn: either the camera swept up and down, or the film lies on its side. Look around "
    "more while you film."
)
LOOKED_DOWN = (
    "Up may be wrong by a quarter turn: the camera looked one way throughout, and either steeply down, as is assumed, "
    "or ahead as it rose. Turn it to several sides while you film."
)
ROSE = (
    "Up may be wrong by a quarter turn: the camera moved mostly along what seems to be up. Walk to and fro on level "
    "ground while you film."
)
TURNED_OVER = (
    "Up may be wrong by half a turn: the camera looks up on average, at a place mostly above it, as where a film is "
    "upside down. If it is, rotate it with `ffmpeg -display_rotation 180 -i FILM -c copy TURNED.mp4`, or photos by "
    "half a turn, and capture the result."
)
UNTOLD = "Record the place again with a version of the app that records which way is up."


def why_not_upright(found: Reconstruction, photos: Photos) -> str | None:
    """Return how images are rotated, and what to do; None if they are upright.

    Args:
        found: a reconstruction in any frame.
        photos: the images that it was made from.
    """
    held = held_poses(found)
    if on_its_side(held):
        return LIES.format(_advice(photos)[0])
    return UPSIDE_DOWN.format(_advice(photos)[1]) if upside_down(held, found.points.numpy()) else None


def doubt_of_up(camera_to_world: Floats, points: Floats, up: Floats, level: bool = False) -> str | None:
    """Return why up may be wrong by a quarter or half turn although the images are not refused; None if it is clear.

    Args:
        camera_to_world: [N, 4, 4] poses of the cameras as they were held, OpenCV camera axes.
        points: [P, 3].
        up: [3] unit vector, what was taken for up.
        level: whether the cameras are known to have moved on a level.
    """
    down, centers = if_steeply_down(camera_to_world), camera_to_world[:, :3, 3]
    around = float(np.median(np.linalg.norm(points - centers.mean(0), axis=1)))
    rises = float((centers @ up).std()) > RISEN * around and share_along(centers, up) > RISES
    doubts = {
        SWEPT: sweeps(camera_to_world),
        LOOKED_DOWN: down is not None and float(down.up @ up) > HALF_WAY and not level,
        ROSE: rises,
        TURNED_OVER: looks_up(camera_to_world, points, up, MOSTLY_ABOVE),
    }
    return next((said for said, true in doubts.items() if true), None)


def _advice(photos: Photos) -> tuple[str, str]:
    if photos.camera_to_world is not None:
        return POSED if photos.files else (UNTOLD, UNTOLD)
    return PHOTOS if photos.files else FILM
