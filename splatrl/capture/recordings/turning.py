"""Quarter turns that bring the images of a recording upright, with their poses and intrinsics."""

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
from PIL import Image

from splatrl.capture.held import cameras_up, on_its_side
from splatrl.capture.lens import Floats

TRANSPOSED = {1: Image.Transpose.ROTATE_90, 2: Image.Transpose.ROTATE_180, 3: Image.Transpose.ROTATE_270}
"""Pillow's names of counter-clockwise turns, by their number of quarters."""
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from the axes of a camera whose image was turned a quarter counter-clockwise to those it had before."""
ORIENTATIONS = {3: 2, 6: 3, 8: 1}
"""Counter-clockwise quarter turns that EXIF's orientations ask for; mirrored images are left as they are stored."""


def quarter_turns(camera_to_world: Floats, up: Floats) -> int:
    """Return how many quarters to turn images counter-clockwise so that most stand upright.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes.
        up: [3], the upward direction.
    """
    x, y, _ = np.einsum("nij,i->j", camera_to_world[:, :3, :3], up)
    return round(math.atan2(x, -y) / (0.5 * math.pi)) % 4


def stated_turns(camera_to_world: Floats, orientations: Iterable[int]) -> int:
    """Return how many quarters to turn images counter-clockwise, by the orientation that most have in their EXIF.

    Tools that turn images may leave their old orientation in place, so poses that contradict it take precedence: images
    would lie on their side, or the cameras would look up rather than down.

    Args:
        camera_to_world: [N, 4, 4], OpenCV camera axes of the images as they are stored, in any frame.
        orientations: N numbers of EXIF, 1 to 8.
    """
    turns = ORIENTATIONS.get(Counter(orientations).most_common(1)[0][0], 0)
    turned = turned_poses(camera_to_world, turns)
    looks_up = turns == 2 and (turned[:, :3, 2] @ cameras_up(turned).up).mean() > 0
    return 0 if looks_up or (turns in (1, 3) and on_its_side(turned)) else turns


def turned_image(image: Image.Image, turns: int) -> Image.Image:
    """Turn an image counter-clockwise by quarters."""
    return image if turns == 0 else image.transpose(TRANSPOSED[turns])


def turned_poses(camera_to_world: Floats, turns: int) -> Floats:
    """Return the poses [..., 4, 4] of cameras whose images were turned."""
    turned = camera_to_world.copy()
    turned[..., :3, :3] = turned[..., :3, :3] @ np.linalg.matrix_power(QUARTER, turns)
    return turned


def turned_camera(size: tuple[int, int], K: Floats, turns: int) -> tuple[tuple[int, int], Floats]:
    """Return the width and height, pixels, and the K [3, 3] of images that were turned."""
    (width, height), (fx, fy, cx, cy) = size, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    for _ in range(turns):
        fx, fy, cx, cy, width, height = fy, fx, cy, width - cx, height, width
    return (width, height), np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
