"""What never changes in a film, like the deck of the robot that carries the camera, is found and left out."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import ndimage

from splatrl.capture import pipeline
from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.check import colour_corrected, psnr, ssim
from splatrl.capture.matches import features
from splatrl.capture.pipeline import reconstruct
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.job import DATABASE
from splatrl.capture.stereo import Depths
from splatrl.capture.unchanging import FEWEST, MOST, REACH, left_out, left_out_at, said, too_much, unchanging, with_mask
from tests.capture import ray_cast
from tests.capture.ray_cast import photos_of, walk

HEIGHT, WIDTH, COUNT = 90, 160, 24
DECK = np.zeros((HEIGHT, WIDTH), bool)
DECK[70:, 20:] = True
PLAIN = 110
"""Column from which the deck has no texture."""


def _film(deck: float = 40.0, drift: float = 0.0, bare: int = 0) -> np.ndarray:
    """Return grey images [N, H, W] of changing texture, with a deck that is textured on its left; 0 for none.

    Args:
        deck: standard deviation of the deck's texture, grey levels.
        drift: amplitude of a gain that drifts.
        bare: number of upper rows that always show a bare wall, or a bare floor up to the deck.
    """
    random = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(random.normal(size=(COUNT + 1, HEIGHT, WIDTH)), (0, 2, 2))
    texture *= 40.0 / texture.std()
    texture[COUNT, :, PLAIN:] = 0.0
    images = 120.0 + texture[:COUNT]
    images[:, :bare] = 150.0
    if deck:
        images[:, DECK] = 100.0 + texture[COUNT, DECK] * deck / 40.0
    images *= 1.0 + drift * np.sin(np.arange(COUNT))[:, None, None]
    return np.clip(images + random.normal(size=images.shape), 0.0, 255.0)


@pytest.mark.parametrize("drift", [0.0, 0.25])
def test_a_deck_is_found_although_the_brightness_drifts_and_the_rest_is_kept(drift: float) -> None:
    for bare in (0, HEIGHT // 2):
        found = unchanging(_film(drift=drift, bare=bare))
        deck = DECK[:, : PLAIN + REACH]
        assert found[:, : PLAIN + REACH][deck].all() and not found[:64].any() and not found[:, :14].any()


@pytest.mark.parametrize("deck", [40.0, 0.0])
def test_a_bare_floor_that_touches_the_deck_is_left_out_only_next_to_it(deck: float) -> None:
    images = _film(bare=70)
    images[:, DECK] += (deck - 40.0) / 40.0 * (images[:, DECK] - 100.0)  # a plain deck has an outline on the floor
    images[:, 70:, :20] = 150.0
    found = unchanging(images)
    assert found[70 : 70 + REACH, 20:].all() and not found[: 70 - REACH - 4].any()
    assert 0.15 < found.mean() < MOST


@pytest.mark.parametrize("bare", [0, HEIGHT // 2])
def test_nothing_is_found_in_a_film_without_a_deck_nor_in_one_of_a_bare_wall(bare: int) -> None:
    assert not unchanging(_film(deck=0.0, bare=bare)).any()
    assert not unchanging(np.full((COUNT, HEIGHT, WIDTH), 128.0)).any()


def _photos(folder: Path, greys: np.ndarray) -> Photos:
    return photos_of(folder, [np.uint8(grey)[..., None].repeat(3, -1) for grey in greys])


def test_the_mask_is_as_large_as_the_photos_and_the_remark_says_where_it_is(tmp_path: Path) -> None:
    photos = _photos(tmp_path / "in", _film().repeat(2, 1).repeat(2, 2))
    found = with_mask(photos, tmp_path)
    assert found.mask is not None
    dark = left_out(found.mask)
    assert dark.shape == (photos.height, photos.width) and dark[150:, 60:240].all() and not dark[:120].any()
    assert not dark[:, :32].any(), "what is beside a deck is kept"
    assert said(found.mask).startswith(f"{100 * dark.mean():.0f} % of the image, mostly at the bottom, never changes")
    assert too_much(found.mask) is None
    Image.fromarray(np.uint8(255) * (np.indices((10, 100)).sum(0) == 0)).save(tmp_path / "nearly.png")
    assert said(tmp_path / "nearly.png").startswith("100 % of the image")
    few = replace(photos, paths=photos.paths[: FEWEST - 1])
    for other in (few, replace(photos, camera_to_world=torch.eye(4).expand(COUNT, 4, 4))):
        assert with_mask(other, tmp_path).mask is None
    assert with_mask(_photos(tmp_path / "other", _film(deck=0.0)), tmp_path / "b").mask is None


def test_the_digits_of_a_clock_that_change_are_left_out_with_the_rest_of_the_line(tmp_path: Path) -> None:
    images, random = _film(deck=0.0), np.random.default_rng(1)
    letters, digits = (slice(8, 14), slice(10, 70)), (slice(8, 14), slice(72, 84))
    images[:, *letters] = random.choice([0.0, 255.0], (6, 30)).repeat(2, 1)
    images[:, *digits] = random.choice([0.0, 255.0], (COUNT, 6, 6)).repeat(2, 2)
    found = with_mask(_photos(tmp_path / "in", images.repeat(2, 1).repeat(2, 2)), tmp_path)
    assert found.mask is not None
    dark = left_out(found.mask)[::2, ::2]
    assert dark[letters].all() and dark[digits].all()
    assert not dark[20:].any() and not dark[:, 110:].any()


def _looks(monkeypatch: pytest.MonkeyPatch, cause: str | None, masks: list[Path | None]) -> None:
    """Replace the first look by one that finds this cause, and notes the masks that it is given."""

    def look(photos: Photos, *_: object) -> SimpleNamespace:
        masks.append(photos.mask)
        return SimpleNamespace(cause=lambda: cause)

    monkeypatch.setattr(pipeline, "look", look)


def test_a_film_that_shows_mostly_the_robot_is_refused_and_a_still_camera_is_named_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = _film()
    images[:, 30:] = images[0, 30:]
    _photos(tmp_path / "in", images)
    seen: list[Path | None] = []
    settings = CaptureSettings(marker=None, still=True)
    for cause, message in (
        (None, "70 % of the image, mostly around its middle, never"),
        ("hardly moved", "hardly moved"),
    ):
        _looks(monkeypatch, cause, seen)
        with pytest.raises(CaptureError, match=message):
            reconstruct(tmp_path / "in", tmp_path / "out", settings, say=lambda _: None)
    assert seen == [None, None], "what moves is looked for in the whole image"


def test_cameras_of_a_robot_that_sees_its_own_deck_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Path | None] = []
    _looks(monkeypatch, None, seen)
    K, size, top = ray_cast.K * [[0.5], [0.5], [1.0]], (160, 120), 85
    truth = walk(24)[: 2 * FEWEST : 2]
    images = [ray_cast.room_image(pose, 0, K, size).copy() for pose in truth]
    for image in images:
        image[top:] = ray_cast.room_image(truth[0], 1, K, size)[top:]
    photos_of(tmp_path / "in", images)
    said: list[str] = []
    placed, notes = reconstruct(
        tmp_path / "in", tmp_path / "out", CaptureSettings(marker=None, still=True), say=said.append
    )
    assert any("mostly at the bottom, never changes" in note for note in notes) and notes[-1] in "\n".join(said)
    found, true = placed.reconstruction, torch.from_numpy(truth)
    assert len(found.paths) == len(truth) and seen[0] is not None
    masked, whole = (features(tmp_path / "in" / "0000.png", mask) for mask in (seen[0], None))
    assert masked.points[:, 1].max() < top < whole.points[:, 1].max() and 50 < masked.distinct < whole.distinct
    with closing(sqlite3.connect(tmp_path / "out" / "stages" / "structure" / DATABASE)) as database:
        for count, columns, data in database.execute("SELECT rows, cols, data FROM keypoints"):
            assert count > 50 and np.frombuffer(data, np.float32).reshape(count, columns)[:, 1].max() < top
    far = [(poses[:, None, :3, 3] - poses[:, :3, 3]).norm(dim=-1) for poses in (found.camera_to_world, true)]
    assert torch.allclose(far[0] * float((far[1] / far[0]).nanmedian()), far[1], atol=0.04)
    world_to_camera = torch.linalg.inv(found.camera_to_world)[found.seen_by]
    local = world_to_camera[:, :3] @ torch.nn.functional.pad(found.points[found.seen_point], (0, 1), value=1)[..., None]
    pixel = (found.K @ local)[..., 0]
    assert float((pixel[:, 1] / pixel[:, 2]).max()) < top
    assert found.mask is not None and found.mask.parent.name == "undistorted_mask"
    small = left_out_at(found, 60, 80)
    assert small is not None and small[43:].all() and not small[:38].any()


def test_pixels_that_are_left_out_add_up() -> None:
    deck, people = torch.zeros(2, 1, 4, 5, dtype=torch.bool)
    deck[0, 3], people[0, :, 0] = True, True
    depths = Depths(torch.ones(1, 4, 5), torch.ones(1, 4, 5)).without(deck).without(people)
    assert depths.moving is not None and torch.equal(depths.moving, deck | people)
    assert not depths.known[deck | people].any() and not depths.likely[deck | people].any()
    assert depths.known[~(deck | people)].all()


def test_held_out_images_are_judged_without_what_is_left_out() -> None:
    random = np.random.default_rng(0)
    photo = random.random((HEIGHT, WIDTH, 3))
    image = np.clip(0.8 * photo + 0.1 + 0.02 * random.normal(size=photo.shape), 0.0, 1.0)
    painted = photo.copy()
    painted[DECK] = 0.0
    whole, some = np.ones_like(DECK), ~DECK
    some[64:] = False  # the window of the structural similarity reaches farther than the deck
    for score in (psnr, ssim):
        assert score(image, painted, whole) == score(image, painted) < score(image, painted, some)
        assert score(image, painted, some) == pytest.approx(score(image, photo, some))
    fitted = colour_corrected(image, painted, ~DECK)
    np.testing.assert_allclose(fitted, colour_corrected(image, photo, ~DECK))
    assert psnr(fitted, photo) > 31 > psnr(colour_corrected(image, painted), photo)


def test_an_image_that_is_left_out_as_a_whole_has_a_brightness_and_no_features(tmp_path: Path) -> None:
    path = _photos(tmp_path / "in", _film()[:1]).paths[0]
    Image.new("L", (WIDTH, HEIGHT)).save(tmp_path / "black.png")
    found = features(path, tmp_path / "black.png")
    assert found.brightness == features(path).brightness and len(found.points) == 0


def test_corners_and_bars_that_never_change_are_said_to_be_along_the_edges(tmp_path: Path) -> None:
    rows, columns = np.indices((60, 90))
    corners = np.hypot(rows - 30, columns - 45) > 48
    bars = (rows < 6) | (rows >= 52)
    for dark, where in ((corners, "along its edges"), (bars, "along its edges"), (~corners, "around its middle")):
        Image.fromarray(np.uint8(255) * ~dark).save(tmp_path / "mask.png")
        assert f"% of the image, mostly {where}, never changes" in said(tmp_path / "mask.png")


def test_a_mask_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((3, 4), np.uint8)).save(tmp_path / "good.png")
    assert left_out(tmp_path / "good.png").all()
    (tmp_path / "mask.png").write_bytes(b"no image")
    with pytest.raises(CaptureError, match=r"mask\.png: expected an image"):
        left_out(tmp_path / "mask.png")
