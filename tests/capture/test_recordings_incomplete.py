"""Recordings that lack something, or whose files are damaged in part, are used as far as they go."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatrl.capture.recordings import read_recording
from tests.capture.ray_cast import damage_frame, write_video
from tests.capture.recorded import (
    ARKIT_FROM_ROOM,
    Taken,
    as_seen,
    taken,
    write_nerfstudio,
    write_polycam,
    write_record3d,
    write_stray,
)

pytest.importorskip("imagecodecs")


@pytest.fixture(scope="module")
def images() -> list[Taken]:
    return taken(8)


def test_images_whose_depth_file_is_missing_are_used_without_depth(tmp_path: Path, images: list[Taken]) -> None:
    source = write_nerfstudio(tmp_path / "in", images)
    (source / "depth" / "frame_00003.png").unlink()
    photos = read_recording(source, tmp_path / "out")
    empty = [not np.asarray(Image.open(path)).any() for path in photos.depths]
    assert empty == [number == 3 for number in range(8)] and photos.metric
    assert photos.remarks == ("1 of 8 depth images are missing: these images are used without depth.",)


def test_record3d_images_without_a_time_are_left_out(tmp_path: Path, images: list[Taken]) -> None:
    source = write_record3d(tmp_path / "in", images, frameTimestamps=[number / 10 for number in range(7)])
    photos = read_recording(source, tmp_path / "out")
    assert len(photos.paths) == 7
    assert photos.remarks == ("1 of 8 poses have no image or no time, and are not used.",)


def test_a_row_of_stray_scanner_that_was_cut_off_is_left_out(tmp_path: Path, images: list[Taken]) -> None:
    source = write_stray(tmp_path / "in", images)
    (source / "odometry.csv").write_text((source / "odometry.csv").read_text()[:-60])
    photos = read_recording(source, tmp_path / "out")
    assert len(photos.paths) == 7
    assert photos.remarks == ("The last row of odometry.csv is cut off, and is not used.",)


def test_rows_of_stray_scanner_beyond_the_end_of_the_video_are_left_out(tmp_path: Path, images: list[Taken]) -> None:
    source = write_stray(tmp_path / "in", images)
    write_video(source / "rgb.mp4", [one.image for one in images[:5]])
    photos = read_recording(source, tmp_path / "out", count=(5, 5))
    assert len(photos.paths) == 5 and as_seen(photos, 4, ARKIT_FROM_ROOM)[0] < 8
    assert photos.remarks == (
        "odometry.csv has rows up to frame 7, but rgb.mp4 has only 5 frames: 3 of 8 rows are not used.",
    )


def test_damaged_frames_of_stray_scanner_do_not_shift_the_poses_of_the_others(
    tmp_path: Path, images: list[Taken]
) -> None:
    source = write_stray(tmp_path / "in", images)
    write_video(source / "rgb.mp4", [one.image for one in images], intra=True)
    damage_frame(source / "rgb.mp4", 3)
    photos = read_recording(source, tmp_path / "out")
    assert len(photos.paths) == 7 and as_seen(photos, 6, ARKIT_FROM_ROOM)[0] < 8
    assert photos.remarks == ("1 of 8 images are damaged, and are not used.",)


def test_a_recording_may_lack_depth_for_all_images_or_for_one(tmp_path: Path, images: list[Taken]) -> None:
    source = write_record3d(tmp_path / "in", images)
    for file in (source / "rgbd").glob("*.depth"):
        file.unlink()
    assert read_recording(source, tmp_path / "out").depths == ()
    source = write_polycam(tmp_path / "half", images)
    sorted((source / "keyframes" / "depth").iterdir())[0].unlink()
    photos = read_recording(source, tmp_path / "other")
    empty = [not np.asarray(Image.open(path)).any() for path in photos.depths]
    assert sorted(empty) == [False] * 7 + [True]
