"""What a policy sees of the images of another camera."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.evaluation.policy_camera import Eye

WIDE = math.degrees(2 * math.atan(2.0))
"""Field of view of a camera that sees twice as far to either side as one of 90°."""


def photo(fov_deg: float, height: int, width: int) -> Image.Image:
    """Take a picture of a plane whose colour grows to the right in red and downwards in green."""
    pixel = 2 * math.tan(math.radians(fov_deg) / 2) / width
    x, y = (pixel * (np.arange(count) + 0.5 - count / 2) for count in (width, height))
    across, down = np.meshgrid(x, y)
    return Image.fromarray(np.stack([127 + 60 * across, 127 + 60 * down, 0 * down], -1).round().astype(np.uint8))


@pytest.mark.parametrize(
    ("fov_deg", "height", "width"),
    [(90.0, 120, 160), (90.0, 300, 160), (WIDE, 120, 320), (WIDE, 240, 320), (100.0, 720, 960)],
)
def test_a_camera_that_sees_more_shows_what_the_policys_own_would(fov_deg: float, height: int, width: int) -> None:
    eye, image = Eye(12, 16, fov_deg=90.0, film_fov_deg=fov_deg), photo(fov_deg, height, width)
    own = np.array(photo(90.0, 12, 16)).astype(int)
    assert np.abs(eye.fitted(image).numpy() - own).max() <= 1
    assert eye.note(image) == ""


def test_edges_are_repeated_where_a_camera_shows_less() -> None:
    own = np.array(photo(90.0, 12, 16)).astype(int)
    low = photo(90.0, 80, 160)  # two of the policy's rows are missing above, and two below
    rows = np.arange(12).clip(2, 9)
    assert np.abs(Eye(12, 16).fitted(low).numpy() - own[rows]).max() <= 1
    narrow = math.degrees(2 * math.atan(0.5))
    rows, columns = np.arange(12).clip(3, 8), np.arange(16).clip(4, 11)
    found = Eye(12, 16, film_fov_deg=narrow).fitted(photo(narrow, 120, 160))
    assert np.abs(found.numpy() - own[rows][:, columns]).max() <= 1


def test_a_note_says_which_angles_a_camera_shows_across_and_down() -> None:
    square, film = Eye(32, 32, fov_deg=90.0, film_fov_deg=69.0), Image.new("RGB", (960, 540))
    assert square.note(film) == "shows 69° × 42° of the policy's 90° × 90°; its edges are repeated beyond"
    assert Eye(32, 32).note(film) == (
        "shows 90° × 59° of the policy's 90° × 90° if it spans 90° across, as the policy's camera does (fov=); its "
        "edges are repeated beyond"
    )


@pytest.mark.parametrize(("height", "width"), [(4, 6), (2, 3), (8, 12)])
def test_an_image_is_shrunk_by_averaging_areas(height: int, width: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)
    cells = image.reshape(height, 8 // height, width, 12 // width, 3).mean((1, 3))
    assert np.abs(Eye(height, width).fitted(Image.fromarray(image)).numpy() - cells).max() <= 0.51


def test_pixels_are_weighted_by_the_area_that_is_covered() -> None:
    line = np.array([[0, 90, 210]], np.uint8)[..., None].repeat(3, -1)
    shrunk = Eye(2, 2).fitted(Image.fromarray(line.repeat(3, 0)))
    assert shrunk[0, :, 0].tolist() == [30, 170]  # each covers one and a half of the three pixels


@pytest.mark.parametrize("size", [(7, 9), (640, 480), (33, 1000), (1000, 33), (1, 1), (4000, 1)])
@pytest.mark.parametrize("fov_deg", [1.0, 60.0, 179.0])
def test_a_uniform_image_stays_uniform_at_any_size(size: tuple[int, int], fov_deg: float) -> None:
    seen = Eye(12, 16, film_fov_deg=fov_deg).fitted(Image.new("RGB", size, (7, 100, 255)))
    assert (seen == torch.tensor([7, 100, 255])).all()
