"""Check that a film is upright: one that lies on its side or is upside down can be captured only by force."""

from splatrl.capture.base import Reconstruction
from splatrl.capture.ground import on_its_side, upside_down
from splatrl.capture.world import held_poses

LIES = (
    "lies on its side: expected upright images, got images rotated by a quarter turn. Rotate the film in an editor, or "
    "with `ffmpeg -display_rotation 90 -i FILM -c copy TURNED.mp4` (or 270), and capture the result."
)
UPSIDE_DOWN = (
    "is upside down: expected upright images, got a camera that looks up on average, at a place mostly above it. "
    "Rotate the film with `ffmpeg -display_rotation 180 -i FILM -c copy TURNED.mp4`, and capture the result."
)


def why_not_upright(found: Reconstruction) -> str | None:
    """Return how the images of a reconstruction in any frame are rotated, and what to do; None if they are upright."""
    held = held_poses(found)
    if on_its_side(held):
        return LIES
    return UPSIDE_DOWN if upside_down(held, found.points.numpy()) else None
