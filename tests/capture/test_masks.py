"""Masks of what moved fit the photos, and poses that are found with them do not depend on what moved."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.capture.base import Photos, Reconstruction
from splatrl.capture.lens import Lens
from splatrl.capture.masks import GROWN, in_view, masks_of, much_moves, write_masks
from splatrl.capture.poses import find_poses
from splatrl.capture.undistort import distorted
from tests.capture import ray_cast
from tests.capture.ray_cast import photos_of, room_image, walk
from tests.capture.test_poses import HEIGHT, WIDTH, K, _similar

cv2 = pytest.importorskip("cv2")
pytest.importorskip("pycolmap")
TOP = 50
"""Rows of the images below that show something else, pixels."""


def _reconstruction(numbers: list[int], lens: Lens | None = None, film: bool = True) -> Reconstruction:
    """Return a reconstruction of these photos, without points."""
    empty, whole = torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, dtype=torch.int64)
    poses = torch.eye(4, dtype=torch.float64).repeat(len(numbers), 1, 1)
    seconds = torch.tensor(numbers, dtype=torch.float64) if film else None
    paths = [Path(f"{row:04}.jpg") for row in range(len(numbers))]
    given = Reconstruction(
        paths, 80, 60, torch.from_numpy(K * [[0.5], [0.5], [1.0]]), poses, empty, empty, whole, whole
    )
    return replace(given, seconds=seconds, numbers=torch.tensor(numbers), lens=lens)


@pytest.mark.parametrize("film", [True, False])
def test_each_photo_gets_a_mask_of_its_size_and_held_out_images_of_films_that_of_their_neighbours(
    film: bool, tmp_path: Path
) -> None:
    photos = Photos([Path(f"IMG_{number}.jpg") for number in range(12)], 80, 60, torch.arange(12).double())
    numbers = [number for number in range(12) if number != 2]
    moving = torch.zeros(11, 15, 20, dtype=torch.bool)
    moving[7, 4:13, 4:10] = moving[9, 4:13, 12:18] = True  # the image between them, the eighth, is held out
    masks = masks_of(moving, _reconstruction(numbers, film=film), photos)
    assert masks is not None
    write_masks(tmp_path, masks, photos)
    images = [np.asarray(Image.open(tmp_path / f"IMG_{number}.jpg.png")) for number in range(12)]
    assert all(mask.shape == (60, 80) and mask.dtype == np.uint8 for mask in images)
    black = [number for number, mask in enumerate(images) if (mask == 0).any()]
    assert black == ([8, 9, 10] if film else [8, 10]) and in_view(tmp_path) == pytest.approx(len(black) / 12)
    area = 4 * (9 + 2 * GROWN) * 4 * (6 + 2 * GROWN)
    assert [(images[number] == 0).sum() for number in (8, 10)] == [area] * 2
    assert not film or np.array_equal(images[9], np.minimum(images[8], images[10]))
    photos, found = replace(photos, moving=tmp_path), _reconstruction(numbers, film=film)
    assert masks_of(moving, found, photos) is None, "nothing that was not masked before"
    moving[7], moving[3, 2:13, 2:18] = False, True
    more = masks_of(moving, found, photos)
    assert more is not None and (more == masks)[[number for number in range(12) if number != 4]].all()
    assert more[4].any() and not masks[4].any()


def test_much_moves_only_above_a_few_percent_and_a_folder_without_masks_shows_nothing(tmp_path: Path) -> None:
    moving = torch.zeros(4, 10, 10, dtype=torch.bool)
    moving[0, 0] = True
    assert not much_moves(moving) and in_view(tmp_path) is None
    moving[:, 0] = True
    assert much_moves(moving)


@pytest.mark.parametrize("fisheye", [False, True])
def test_masks_are_moved_to_where_the_lens_showed_the_same(fisheye: bool) -> None:
    fx, fy, cx, cy, distortion = 70.0, 68.0, 41.0, 29.0, (0.2, 0.05, 0.0, 0.0)
    found = _reconstruction([0], Lens(80, 60, fx, fy, cx, cy, distortion, fisheye))
    masks = np.zeros((1, 60, 80), bool)
    masks[0, 8:11, 10:13] = True
    ray = np.linalg.inv(found.K.numpy()) @ [11.5, 9.5, 1.0]
    model, K = cv2.fisheye if fisheye else cv2, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    there = model.projectPoints(ray[None, None], np.zeros(3), np.zeros(3), K, np.array(distortion))[0].reshape(1, 2)
    line, column = np.argwhere(distorted(masks, found)[0]).mean(0) + 0.5
    assert np.linalg.norm(there[0] - [11.5, 9.5]) > 1
    assert np.linalg.norm(there[0] - [column, line]) < 0.8
    assert distorted(masks, _reconstruction([0])) is masks, "images without distortion"


def test_poses_with_masks_are_those_of_the_place_although_something_that_moves_fills_much_of_the_image(
    tmp_path: Path,
) -> None:
    truth, size = walk(24)[::4], (WIDTH, HEIGHT)
    images = [room_image(pose, 0, K, size).copy() for pose in truth]
    (tmp_path / "masks").mkdir()
    for number, (image, pose) in enumerate(zip(images, truth[::-1], strict=True)):
        image[:TOP] = room_image(pose, 1, K, size)[:TOP]
        mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
        mask[: TOP + 2] = 0
        Image.fromarray(mask).save(tmp_path / "masks" / f"{number:04}.png.png")
    photos = replace(photos_of(tmp_path / "in", images), K=torch.from_numpy(ray_cast.K * [[0.5], [0.5], [1.0]]))
    first = find_poses(photos, tmp_path / "out", least=0.0, exact_camera=True)
    again = find_poses(replace(photos, moving=tmp_path / "masks"), tmp_path / "out", exact_camera=True)
    assert len(first.paths) < len(truth) or _similar(first.camera_to_world.numpy(), truth)[0] > 0.1
    distance, angle = _similar(again.camera_to_world.numpy(), truth)
    assert distance < 0.03 and angle < 0.02 and again.numbers is not None and again.numbers.tolist() == [*range(6)]
    told: list[str] = []
    for given in (photos, replace(photos, moving=tmp_path / "masks")):
        find_poses(given, tmp_path / "out", least=0.0, exact_camera=True, progress=lambda what, *_: told.append(what))
    assert not told, "both are kept"
