"""Frames of videos are shown as players show them, and damaged ones are left out."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatrl.capture.base import CaptureError
from splatrl.capture.frames import read_photos
from tests.capture.ray_cast import QUARTER_TURN, damage_frame, room_image, walk, write_video


def _read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(float)


@pytest.mark.parametrize(
    ("shown", "corner"),
    [
        ((-1, 0, 0, 1), (0, -1)),  # mirrored left to right, as by the camera on the front
        ((1, 0, 0, -1), (-1, 0)),
        ((-1, 0, 0, -1), (-1, -1)),
        ((0, -1, 1, 0), (-1, 0)),  # a quarter turn counter-clockwise
        ((0, 1, 1, 0), (0, 0)),  # mirrored about a diagonal
        ((0, -1, -1, 0), (-1, -1)),
    ],
)
def test_mirrored_frames_are_shown_as_players_show_them(
    tmp_path: Path, shown: tuple[int, int, int, int], corner: tuple[int, int]
) -> None:
    image = np.full((240, 320, 3), 60, np.uint8)
    image[:60, :80] = (250, 20, 20)
    write_video(tmp_path / "a.mov", [image] * 4, shown=shown)
    red = _read(read_photos(tmp_path / "a.mov", tmp_path / "out", count=(2, 2)).paths[0])[10:-10, 10:-10, 0]
    assert red.shape[0] == (300 if shown[0] == 0 else 220)
    assert [place for place in ((0, 0), (0, -1), (-1, 0), (-1, -1)) if red[place] > 200] == [corner]


def test_a_few_damaged_frames_of_a_film_are_left_out_and_mentioned(tmp_path: Path) -> None:
    images = [room_image(pose) for pose in walk(40)]
    write_video(tmp_path / "a.mp4", images, intra=True)
    damage_frame(tmp_path / "a.mp4", 17)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(40, 40))
    assert len(photos.paths) == 39
    assert photos.remarks == ("1 of 40 frames of a.mp4 are damaged, and are not used.",)
    for seconds, path in zip(photos.seconds.tolist(), photos.paths, strict=True):
        assert np.abs(_read(path) - images[round(10 * seconds)]).mean() < 12
    assert read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(40, 40)).remarks == photos.remarks
    for number in (3, 9):
        damage_frame(tmp_path / "a.mp4", number)
    with pytest.raises(CaptureError, match=r"a\.mp4: expected at most 3 % damaged frames, got 3 of 40"):
        read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(40, 40))


def test_frames_of_a_rotated_phone_are_turned_upright_and_scaled(tmp_path: Path) -> None:
    image = np.full((240, 320, 3), 60, np.uint8)
    image[:60, :80] = (250, 20, 20)  # top left as recorded: top right once turned clockwise
    write_video(tmp_path / "a.mov", [image] * 8, shown=QUARTER_TURN)
    photos = read_photos(tmp_path / "a.mov", tmp_path / "out", count=(4, 4), longest=160)
    assert (photos.width, photos.height) == (120, 160)
    shown = _read(photos.paths[0])
    assert shown[10, 110, 0] > 200 and shown[10, 10, 0] < 100 and shown[150, 110, 0] < 100
