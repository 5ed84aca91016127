"""The check tells a good capture from one with wrong colours, a blocked path or floaters."""

import math
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatrl.capture.area import Area, dense_voxels, survey_area
from splatrl.capture.base import CaptureError
from splatrl.capture.check import check, colour_corrected, psnr, ssim
from splatrl.capture.floaters import hazy_voxels, seen_through, without_floaters
from splatrl.capture.pictures import camera_path, draw_map
from splatrl.capture.world import Placed
from splatrl.collision.occupancy import Occupancy
from tests.capture.rooms import CAMERAS, FLOATER, HAZE, tiny_capture, with_floater, with_haze
from tests.tiny import tiny_gaussians

HELD_OUT = range(3, CAMERAS, 8)


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Placed, Area]:
    """Return the tiny room as a capture, and its area."""
    placed = tiny_capture(tmp_path_factory.mktemp("images"))
    return placed, survey_area(tiny_gaussians(), placed)


def test_a_perfect_fit_scores_high_and_its_path_is_free(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path / "images")
    told: list[tuple[str, int, int]] = []
    quality = check(tiny_gaussians(), placed, HELD_OUT, tmp_path, progress=lambda *far: told.append(far))
    assert told == [("check", 1, 3), ("check", 2, 3), ("check", 3, 3)]
    assert quality.psnr is not None and quality.psnr > 50 and quality.ssim == pytest.approx(1.0, abs=1e-3)
    assert (quality.held_out, quality.path_free) == (3, 1.0)
    assert quality.floating < 5, "a few at the soft edge of the red thing, through which the wall is seen"
    assert quality.figures()["voxel_size"] == quality.voxel_size == 0.05
    for picture in ("held_out.png", "map.png"):
        with Image.open(tmp_path / picture) as image:
            assert min(image.size) > 100


def test_held_out_images_are_compared_one_at_a_time_and_large_ones_at_the_size_of_a_films(
    tmp_path: Path, surveyed: tuple[Placed, Area], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splatrl.capture.check.draw_map", lambda *_: None)
    monkeypatch.setattr("splatrl.capture.check.seen_through", lambda *_: np.zeros(1, bool))
    monkeypatch.setattr("splatrl.capture.pictures.WIDTH", 60)
    (placed, area), peaks = surveyed, []
    for rows in (HELD_OUT, range(12)):
        tracemalloc.start()
        check(tiny_gaussians(), placed, rows, tmp_path, area)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    photo = 8 * 3 * 96 * 64
    assert peaks[1] < peaks[0] + 4 * photo, "not a photo and a render for each of nine more"
    with Image.open(tmp_path / "held_out.png") as image:
        assert image.size == (3 * 60 + 8, 6 * (40 + 4) + 20)
    sizes: list[set[tuple[int, ...]]] = []

    def noted(*images: np.ndarray, counted: np.ndarray) -> float:
        assert counted.all()
        sizes.append({image.shape for image in images})
        return 1.0

    monkeypatch.setattr("splatrl.capture.check.LONGEST", 48)
    monkeypatch.setattr("splatrl.capture.check.ssim", noted)
    quality = check(tiny_gaussians(), placed, HELD_OUT, tmp_path, area)
    assert quality.psnr is not None and quality.psnr > 30 and sizes == 6 * [{(32, 48, 3)}]


@pytest.mark.parametrize("longer", [1.0, 12.0])
def test_the_maps_fill_their_picture_however_long_the_place_is(
    longer: float, tmp_path: Path, surveyed: tuple[Placed, Area]
) -> None:
    placed, area = surveyed
    (x0, y0, z0), (x1, y1, z1) = area.bounds
    area = replace(area, bounds=((longer * x0, y0, z0), (longer * x1, y1, z1)))
    draw_map(tiny_gaussians(), placed, area, np.ones(CAMERAS, bool), tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        empty = (np.asarray(image.convert("RGB")) == 255).all(2)
    assert empty.mean() < 0.5


def test_the_way_from_one_take_to_the_next_is_not_drawn(surveyed: tuple[Placed, Area]) -> None:
    found = replace(surveyed[0].reconstruction, seconds=torch.arange(CAMERAS).double(), cuts=(7.5, 8.0, 20.5))
    path = camera_path(replace(surveyed[0], reconstruction=found))
    assert np.flatnonzero(np.isnan(path).all(1)).tolist() == [8, 22]
    np.testing.assert_array_equal(path[~np.isnan(path).any(1)], found.camera_to_world[:, :3, 3])


def test_the_map_shows_the_ground_far_below_a_drone(tmp_path: Path, surveyed: tuple[Placed, Area]) -> None:
    placed, area = surveyed[0], replace(surveyed[1], robot_height=40.0)
    draw_map(tiny_gaussians(), placed, area, np.ones(CAMERAS, bool), tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        red, green, blue = np.asarray(image.convert("RGB"), int)[:, : image.width // 2].transpose(2, 0, 1)
    assert (red > 2 * np.maximum(green, blue)).mean() > 0.001, "the red thing"


@pytest.mark.usefixtures("bare_report")
def test_only_the_colour_corrected_figures_ignore_a_change_of_exposure(tmp_path: Path) -> None:
    quality = check(tiny_gaussians(), tiny_capture(tmp_path / "images", exposure=0.7), HELD_OUT, tmp_path)
    assert quality.psnr is not None and quality.psnr_corrected is not None
    assert quality.psnr < 25 and quality.psnr_corrected > 40


def test_the_figures_reveal_something_solid_on_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatrl.capture.check.draw_map", lambda *_: None)
    quality = check(with_floater(), tiny_capture(tmp_path / "images"), [], tmp_path)
    assert 0.8 < quality.path_free < 1.0 and quality.floating >= 20
    assert quality.psnr is None and not (tmp_path / "held_out.png").exists()


def test_floaters_that_cameras_saw_through_are_removed_and_surfaces_stay(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path)
    solid = dense_voxels(with_floater(), placed)
    carved = seen_through(solid, placed.reconstruction)
    places = (np.argwhere(carved) + solid.origin_key + 0.5) * solid.resolution
    near = np.abs(places - FLOATER).max(1) < 0.25
    assert near.sum() > 15 and (~near).sum() < 5
    kept, count = without_floaters(with_floater(), solid, placed.reconstruction)
    assert count == len(places) and len(kept) < len(with_floater())
    means = {tuple(row) for row in kept.means.tolist()}
    assert sum(tuple(row) not in means for row in tiny_gaussians().means.tolist()) < 5


def test_haze_that_no_image_shows_counts_as_free_and_surfaces_stay_solid(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path)
    dense = dense_voxels(with_haze(), placed)
    hazy = hazy_voxels(dense, with_haze(), placed.reconstruction)
    places = (np.argwhere(hazy) + dense.origin_key + 0.5) * dense.resolution
    near = np.abs(places - HAZE).max(1) < 0.25
    assert near.sum() > 150 and (~near).sum() < 5
    area = survey_area(with_haze(), placed)
    assert area.free.count == hazy.sum() and area.occupancy.count == dense.count - hazy.sum()


def test_an_empty_occupancy_has_no_floaters_and_no_haze(tmp_path: Path) -> None:
    capture = tiny_capture(tmp_path).reconstruction
    assert seen_through(Occupancy.empty(), capture).sum() == 0
    assert hazy_voxels(Occupancy.empty(), tiny_gaussians(), capture).sum() == 0


def test_psnr_ssim_and_colour_correction_match_their_definitions() -> None:
    generator = np.random.default_rng(0)
    image = generator.uniform(0.2, 0.8, (40, 30, 3))
    assert psnr(image, image) == 100.0 and ssim(image, image) == pytest.approx(1.0)
    assert psnr(image, image + 0.1) == pytest.approx(20.0)
    assert ssim(image, generator.uniform(0.2, 0.8, image.shape)) < 0.2
    flat = np.full((40, 30, 3), 0.5)
    expected = (2 * 0.5 * 0.6 + 1e-4) / (0.25 + 0.36 + 1e-4)
    assert ssim(flat, flat + 0.1) == pytest.approx(expected)
    np.testing.assert_allclose(colour_corrected(image, 0.5 * image + [0.1, 0.2, 0.0]), 0.5 * image + [0.1, 0.2, 0.0])
    np.testing.assert_allclose(colour_corrected(flat, image), np.broadcast_to(image.mean((0, 1)), image.shape))
    assert math.isfinite(psnr(colour_corrected(flat, image), image))


def test_an_image_of_the_wrong_size_or_a_missing_one_is_named_in_the_error(tmp_path: Path) -> None:
    placed = tiny_capture(tmp_path)
    wrong = replace(placed, reconstruction=replace(placed.reconstruction, width=90))
    with pytest.raises(CaptureError, match=r"03\.png: expected 90 × 64 pixels, got 96 × 64"):
        check(tiny_gaussians(), wrong, HELD_OUT, tmp_path)
    placed.reconstruction.paths[3].unlink()
    with pytest.raises(CaptureError, match=r"03\.png: expected an image, got"):
        check(tiny_gaussians(), placed, HELD_OUT, tmp_path)
