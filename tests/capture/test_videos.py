"""Frames of videos are shown as players show them, and damaged ones are left out."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.stream import Disposition
from PIL import Image

from splatrl.capture.base import CaptureError
from splatrl.capture.cuts import cuts, pattern
from splatrl.capture.frames import read_photos
from splatrl.capture.poses import job_of
from tests.capture.ray_cast import QUARTER_TURN, damage_frame, room_image, turning, walk, write_video


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


def test_the_video_track_with_the_most_pixels_is_used_unless_it_is_the_cover_picture(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        small, large, cover = (
            container.add_stream("h264", rate=10),
            container.add_stream("h264", rate=10),
            container.add_stream("mjpeg", rate=10),
        )
        for track, height, width in ((small, 48, 64), (large, 96, 128), (cover, 192, 256)):
            track.height, track.width, track.pix_fmt = height, width, "yuvj420p"
        cover.disposition = Disposition.attached_pic
        for track in (small, large, cover):
            for number in range(1 if track is cover else 4):
                frame = av.VideoFrame.from_ndarray(
                    np.full((track.height, track.width, 3), 90, np.uint8), format="rgb24"
                )
                frame.pts, frame.time_base = number, Fraction(1, 10)
                container.mux(track.encode(frame))
            container.mux(track.encode())
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert sorted(track.width for track in container.streams.video) == [64, 128, 256]
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out")
    assert (photos.width, photos.height, len(photos.paths)) == (128, 96, 4)


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


def test_frames_that_are_missing_at_the_end_of_a_film_count_as_damaged(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.mp4", tmp_path / "a.mp4"
    write_video(whole, [room_image(pose) for pose in walk(40)], intra=True, first=True)
    assert read_photos(whole, tmp_path / "all", count=(4, 4)).remarks == ()
    with av.open(str(whole)) as container:
        last = [packet.pos for packet in container.demux(video=0) if packet.pos is not None]
    cut.write_bytes(whole.read_bytes()[: last[39]])
    (remark,) = read_photos(cut, tmp_path / "one", count=(4, 4)).remarks
    assert remark == "1 of 40 frames of a.mp4 are damaged, and are not used; it breaks off, and the last 1 are missing."
    cut.write_bytes(whole.read_bytes()[: last[20]])
    with pytest.raises(CaptureError, match="got 20 of 40; it breaks off, and the last 20 are missing"):
        read_photos(cut, tmp_path / "half", count=(4, 4))


def test_frames_that_an_edit_cuts_off_at_the_end_are_not_missing(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mov", [room_image(pose) for pose in walk(40)], intra=True)
    content = bytearray((tmp_path / "a.mov").read_bytes())
    edit = content.index(b"elst") + 12  # milliseconds that are shown
    assert struct.unpack_from(">I", content, edit) == (4000,)
    struct.pack_into(">I", content, edit, 2000)
    (tmp_path / "a.mov").write_bytes(content)
    photos = read_photos(tmp_path / "a.mov", tmp_path / "out", count=(40, 40))
    assert len(photos.paths) == 20 and photos.remarks == ()


def test_times_of_films_that_were_joined_do_not_go_back(tmp_path: Path) -> None:
    images = [room_image(pose) for pose in walk(20)]
    write_video(tmp_path / "part.ts", images)
    (tmp_path / "a.ts").write_bytes(2 * (tmp_path / "part.ts").read_bytes())
    photos = read_photos(tmp_path / "a.ts", tmp_path / "out", count=(8, 8))
    seconds = photos.seconds.tolist()
    assert [int(2 * second + 1e-6) for second in seconds] == list(range(8)), "one image of each half second"
    for second, path in zip(seconds, photos.paths, strict=True):
        assert np.abs(_read(path) - images[round(10 * second) % 20]).mean() < 12
    assert photos.cuts == pytest.approx([2.0]) and job_of(photos).cuts == photos.cuts


def _join(paths: list[Path], out: Path) -> None:
    """Put videos one after the other without decoding them, as `ffmpeg -f concat -c copy` does."""
    with av.open(str(out), "w") as joined:
        track, end = None, 0
        for path in paths:
            with av.open(str(path)) as film:
                track = track or joined.add_stream_from_template(film.streams.video[0])
                begin = end
                for packet in film.demux(video=0):
                    if packet.pts is not None and packet.dts is not None:
                        packet.pts, packet.dts, packet.stream = packet.pts + begin, packet.dts + begin, track
                        end = max(end, packet.pts + (packet.duration or 0))
                        joined.mux(packet)


def test_films_of_different_sizes_that_were_joined_are_refused_by_when_the_second_begins(tmp_path: Path) -> None:
    images = [room_image(pose) for pose in walk(20)]
    write_video(tmp_path / "first.mp4", images)
    write_video(tmp_path / "turned.mp4", [np.ascontiguousarray(np.rot90(image)) for image in images])
    _join([tmp_path / "first.mp4", tmp_path / "first.mp4"], tmp_path / "same.mp4")
    assert read_photos(tmp_path / "same.mp4", tmp_path / "out", count=(8, 8)).remarks == ()
    _join([tmp_path / "first.mp4", tmp_path / "turned.mp4"], tmp_path / "a.mp4")
    said = r"a\.mp4: expected at most 3 % damaged frames, got \d+ of 40; from 2 s on, .* held differently, were joined"
    with pytest.raises(CaptureError, match=said):
        read_photos(tmp_path / "a.mp4", tmp_path / "other", count=(8, 8))


def test_cuts_are_told_from_fast_turns_flashes_and_gaps() -> None:
    walked = [image[..., 1] for image in map(room_image, walk(60)[:20])]
    elsewhere = [image[..., 1] for image in map(room_image, walk(60)[40:50])]
    turned = [image[..., 1] for image in map(room_image, turning(8))]
    film = [*walked[:10], *elsewhere]

    def found(images: list[np.ndarray], seconds: np.ndarray | None = None) -> list[float]:
        times = np.arange(len(images)) / 10 if seconds is None else seconds
        return cuts(times.tolist(), [pattern(image) for image in images])

    assert found(film) == [1.0] and found(walked) == found(turned) == []
    assert found(film, np.arange(20) / 10 + (np.arange(20) >= 10)) == [], "frames that a phone dropped"
    flash = [np.full_like(image, 255) if number == 15 else image for number, image in enumerate(walked)]
    darker = [image // 3 if number >= 15 else image for number, image in enumerate(walked)]
    assert found(flash) == [] and found(darker) == []
    assert found([walked[0], elsewhere[0], elsewhere[9]]) == [], "each frame shows something else"


def test_one_field_of_interlaced_frames_is_used(tmp_path: Path) -> None:
    images = [np.repeat(room_image(pose)[..., 1:2], 3, 2) for pose in walk(16)]  # grey: two lines share their colours
    with av.open(str(tmp_path / "a.mpg"), "w") as container:
        stream = container.add_stream("mpeg2video", rate=Fraction(25), options={"b": "8M", "flags": "+ildct+ilme"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for upper, lower in zip(images[::8], images[7::8], strict=True):
            combed = upper.copy()
            combed[1::2] = lower[1::2]
            for _ in range(4):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(combed, format="rgb24")))
        container.mux(stream.encode())
    photos = read_photos(tmp_path / "a.mpg", tmp_path / "out", count=(2, 2))
    assert (photos.width, photos.height) == (320, 240)
    for image, lower, path in zip(images[::8], images[7::8], photos.paths, strict=True):
        assert np.abs(_read(path) - image).mean() < 12 < np.abs(lower.astype(float) - image).mean()
