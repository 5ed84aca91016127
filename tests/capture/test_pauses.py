"""Tests of the clock of a film, which stands still in pauses."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatrl.capture.frames import buckets, read_photos
from splatrl.capture.pauses import STILL, small, views, without_pauses
from tests.capture.ray_cast import room_image, walk, write_video

RATE = 8


def _paused(how: str) -> list[np.ndarray]:
    """Return images of a walk of 2 + 2 seconds with a pause of 12 between, each with noise."""
    poses, random = walk(4 * RATE), np.random.default_rng(0)
    walked = [room_image(pose)[12:-12, 16:-16] for pose in poses]
    held, middle = [], Image.fromarray(room_image(poses[2 * RATE]))
    for t in np.arange(0, 12, 1 / RATE):
        sway = (0.0, 0, 0) if how == "tripod" else (0.3 * np.sin(1.7 * t), *np.rint(2 * np.sin([2.3 * t, 3.1 * t])))
        turned = middle.rotate(sway[0], Image.Resampling.BILINEAR, translate=(int(sway[1]), int(sway[2])))
        image = np.asarray(turned)[12:-12, 16:-16] * (1 + 0.2 * np.sin(t) if how == "hand" else 1.0)
        if how == "passer-by" and 2 <= t <= 5:
            place = int((t - 2) / 3 * image.shape[1])
            image[20:, max(0, place - 60) : place] = (40, 60, 120)
        held.append(image)
    film = [*walked[: 2 * RATE], *held, *walked[2 * RATE :]]
    return [np.clip(image + random.normal(0, 4, image.shape), 0, 255).astype(np.uint8) for image in film]


@pytest.mark.parametrize("how", ["tripod", "hand", "passer-by"])
def test_a_pause_costs_hardly_any_images(how: str, tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", _paused(how), rate=RATE)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(24, 24))
    assert 22 <= len(photos.paths) <= 24 and len(list((tmp_path / "out" / "frames").glob("*.jpg"))) == len(photos.paths)
    walked = (photos.seconds < 2) | (photos.seconds >= 14)
    assert walked.sum() >= 12, "by time alone, 6 of 24 images are of the 4 seconds in which the camera moves"
    assert photos.seconds[0] < 0.5 and photos.seconds[-1] > 15.5 and photos.cuts == ()


def test_the_clock_stands_still_once_a_view_was_shown_for_long() -> None:
    times = np.arange(0, 20, 0.125)
    begun = [*np.arange(0, 5, 0.5), *np.arange(15, 20, 0.5)]  # the view that begins at 4.5 is shown until 15
    clock = without_pauses(times, begun)
    expected = np.interp(times, [0, 4.5 + STILL, 15, 20], [0, 4.5 + STILL, 4.5 + STILL, 9.5 + STILL])
    np.testing.assert_allclose(clock, expected)
    assert len(buckets(times, (20, 200), begun)) == len(buckets(times[times < 9.5 + STILL], (20, 200)))


def test_a_film_without_pauses_keeps_its_clock() -> None:
    times = 0.1 + np.arange(100) / 30
    assert without_pauses(times, np.arange(0.1, 3.4, 0.9).tolist()) is times and without_pauses(times, ()) is times


def test_what_shows_nothing_belongs_to_the_view_before() -> None:
    times = np.arange(0, 10, 0.125)
    pocket = without_pauses(times, np.arange(5, 10, 0.5).tolist())
    np.testing.assert_allclose(pocket[times >= 5], STILL + times[times >= 5] - 5)


def test_noise_alone_is_another_view_in_each_frame_and_a_slow_walk_soon() -> None:
    random = np.random.default_rng(0)
    wall = [small(random.normal(120, 8, (270, 480)).clip(0, 255).astype(np.uint8)) for _ in range(8)]
    assert views(range(8), wall) == [*range(8)]
    slow = [small(np.asarray(Image.fromarray(room_image(pose)).convert("L"))) for pose in walk(24)]
    begun = np.array(views([number / 4 for number in range(24)], slow))
    assert np.diff(begun).max() < STILL


def test_views_of_a_film_as_narrow_as_a_line_are_told_apart() -> None:
    random = np.random.default_rng(0)
    lines = [small(random.integers(0, 256, (3, 480), np.uint8)) for _ in range(2)]
    assert views(range(4), [lines[0], lines[0], lines[1], lines[1]]) == [0, 2]
