"""Check that images are upright: those that lie on their side or are upside down can be captured only by force."""

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.ground import on_its_side, upside_down
from splatrl.capture.quarters import held_poses

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
    if on_its_side(held):
        return LIES.format(_advice(photos)[0])
    return UPSIDE_DOWN.format(_advice(photos)[1]) if upside_down(held, found.points.numpy()) else None


def _advice(photos: Photos) -> tuple[str, str]:
    if photos.camera_to_world is not None:
        return POSED if photos.files else (UNTOLD, UNTOLD)
    return PHOTOS if photos.files else FILM
