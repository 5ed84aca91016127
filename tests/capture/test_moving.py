"""Things that move between photos are found, still ones are not, and a fit leaves the moving ones out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.fit import FitSettings, fit, held_out, trained
from splatrl.capture.fitting.pictures import frame_of
from splatrl.capture.moving import asked, difference, find_moving
from splatrl.capture.stereo import Depths, find_depths
from splatrl.renderers import NativeRenderer
from tests.capture.test_stereo import HEIGHT, WIDTH, photographed, speckled

COUNT = 24
RADIUS = 13
"""Radius of the ball in every third photo, pixels; it is at a different place in each."""
SETTINGS = FitSettings(width=WIDTH, cap=14_000, views=350, sh_degree=0, levels=((0.0, 0.5), (0.3, 1.0)), threads=1)


def ball(row: int) -> Tensor:
    """Return the pixels of a photo that show a ball: [H, W] bool."""
    down, across = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    column, line = (29 * row) % WIDTH, 20 + (17 * row) % 35
    inside: Tensor = (across - column) ** 2 + (down - line) ** 2 < RADIUS**2
    return inside & (row % 3 == 1)


def row_of_photos(folder: Path, with_ball: bool) -> Reconstruction:
    """Photograph a speckled wall and a box in front of it; every second photo is 10 % darker."""

    def changed(row: int, image: Tensor) -> Tensor:
        if with_ball:
            image[ball(row)] = torch.tensor([250, 240, 20], dtype=torch.uint8)
        return (image.float() * (1.0 - 0.1 * (row % 2))).byte()

    return photographed(folder, COUNT, 0.6, 40, changed)


def depths_of(capture: Reconstruction) -> Depths:
    return find_depths(capture, frame_of(capture.camera_to_world), trained(COUNT), threads=1)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return row_of_photos(tmp_path_factory.mktemp("still"), with_ball=False)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Reconstruction:
    return row_of_photos(tmp_path_factory.mktemp("with_ball"), with_ball=True)


@pytest.fixture(scope="module")
def depths(capture: Reconstruction) -> Depths:
    return depths_of(capture)


@pytest.fixture(scope="module")
def still_depths(still: Reconstruction) -> Depths:
    return depths_of(still)


@pytest.fixture(scope="module")
def moving(capture: Reconstruction, depths: Depths) -> Tensor:
    return find_moving(capture, depths, SETTINGS)


def test_moving_things_are_found(moving: Tensor) -> None:
    rows, balls = trained(COUNT), torch.stack([ball(row) for row in range(COUNT)])
    found, true = moving[rows], balls[rows]
    assert float(found[true].float().mean()) > 0.8
    assert float(found[~true].float().mean()) < 0.03
    assert not moving[held_out(COUNT)].any()


def test_moving_things_are_found_although_a_depth_sensor_measured_them(capture: Reconstruction, tmp_path: Path) -> None:
    cameras = Cameras(capture.camera_to_world.float(), capture.K.float(), WIDTH, HEIGHT)
    paths = []
    for row, depth in enumerate(NativeRenderer(speckled(), threads=1).render(cameras).depth):
        depth[ball(row)] = 1.0
        paths.append(tmp_path / f"{row:02d}.png")
        Image.fromarray((1000 * depth).numpy().astype(np.uint16)).save(paths[-1])
    measured = replace(capture, depths=tuple(paths))
    found, rows = find_moving(measured, depths_of(measured), SETTINGS), trained(COUNT)
    balls = torch.stack([ball(row) for row in range(COUNT)])
    assert float(found[rows][balls[rows]].float().mean()) > 0.8
    assert float(found[rows][~balls[rows]].float().mean()) < 0.03


def test_nothing_is_found_where_nothing_moves(still: Reconstruction, still_depths: Depths) -> None:
    assert not find_moving(still, still_depths, SETTINGS).any()


def test_what_never_changes_does_not_move_whatever_the_number_of_threads(
    capture: Reconstruction, depths: Depths
) -> None:
    short, deck = replace(SETTINGS, views=160), torch.zeros(COUNT, HEIGHT, WIDTH, dtype=torch.bool)
    deck[..., : WIDTH // 2] = True
    found, again = (find_moving(capture, depths.without(deck), replace(short, threads=count)) for count in (1, 2))
    assert torch.equal(found, again) and found.any() and not found[deck].any()


def test_pixels_that_show_moving_things_never_influence_a_fit(
    still: Reconstruction, still_depths: Depths, tmp_path: Path
) -> None:
    moving = torch.zeros(COUNT, HEIGHT, WIDTH, dtype=torch.bool)
    moving[2:9, 16:40, 30:62] = True
    paths = list(still.paths)
    for row in range(2, 9):
        image = Image.open(paths[row])
        image.paste((255, 0, 255), (30, 16, 62, 40))
        paths[row] = tmp_path / f"{row}.png"
        image.save(paths[row])
    settings, known = replace(SETTINGS, cap=2_500, views=120), still_depths.without(moving)
    plain, painted = (fit(replace(still, paths=each), settings, depths=known) for each in (still.paths, paths))
    assert all(torch.equal(getattr(plain, name), getattr(painted, name)) for name in ("means", "scales", "sh"))


def test_a_change_of_exposure_does_not_count_as_a_difference() -> None:
    drawn = np.random.default_rng(0).random((40, 60, 3))
    photo, nothing = 0.85 * drawn + 0.05, np.zeros((40, 60), bool)
    assert difference(drawn, photo, nothing).max() < 1e-3
    photo[10:30, 10:30] = 1.0
    apart = difference(drawn, photo, nothing)
    assert apart[15:25, 15:25].min() > 0.2 and apart[:, 45:].max() < 0.02


def test_a_photo_is_compared_with_at_most_a_hundred_others_and_not_with_its_neighbours() -> None:
    assert asked(5, 10) == [0, 1, 9]
    assert asked(0, 3) == []
    assert len(asked(7, 1000)) <= 100 and all(abs(other - 7) > 3 for other in asked(7, 1000))
