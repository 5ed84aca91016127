"""Images of 360° cameras are told from others that are twice as wide as high."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from splatrl.capture.around import around
from tests.capture.ray_cast import photos_of, room_image, walk

WIDTH, HEIGHT = 320, 160
COUNT = 10


def _around(folder: Path, images: list[np.ndarray]) -> bool:
    photos = photos_of(folder, images)
    return around(photos.paths, (photos.width, photos.height))


def _all_directions(noise: float) -> list[np.ndarray]:
    """Return images of a place around a camera that turns, with a plain sky and noise of some grey levels."""
    random = np.random.default_rng(0)
    place = ndimage.gaussian_filter(random.normal(size=(HEIGHT, WIDTH)), 4, mode=("nearest", "wrap"))
    place = 110.0 + 40.0 * place / place.std()
    place[: HEIGHT // 2] = 200.0
    turned = [np.roll(place, 13 * number, 1) + noise * random.normal(size=place.shape) for number in range(COUNT)]
    return [np.clip(image, 0, 255).astype(np.uint8)[..., None].repeat(3, -1) for image in turned]


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_images_whose_right_edge_continues_at_the_left_show_all_directions(tmp_path: Path, noise: float) -> None:
    images = _all_directions(noise)
    assert _around(tmp_path / "whole", images)
    assert not _around(tmp_path / "shape", [image[: HEIGHT - 10] for image in images]), "of another shape"
    assert not _around(tmp_path / "part", [image[: HEIGHT // 2, : WIDTH // 2] for image in images])
    assert not _around(tmp_path / "half", [image[HEIGHT // 4 : -HEIGHT // 4, 80:240] for image in images])


def test_other_images_of_that_shape_do_not_show_all_directions(tmp_path: Path) -> None:
    walked = [room_image(pose, size=(WIDTH, HEIGHT)) for pose in walk(COUNT)]
    assert not _around(tmp_path / "walk", walked)
    left = [image[:, : WIDTH // 2] for image in walked]
    assert not _around(tmp_path / "corridor", [np.hstack([image, image[:, ::-1]]) for image in left])
    for image in (barred := [image.copy() for image in walked]):
        image[:, :30] = image[:, -30:] = 255
    assert not _around(tmp_path / "bars", barred)
    assert not _around(tmp_path / "bare", [np.full((HEIGHT, WIDTH, 3), 90, np.uint8)] * COUNT)
