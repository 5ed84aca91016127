"""Frames of videos and photos: the sharpest are chosen, upright and cached, and no file but the source is read."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image, ImageFilter
from PIL.TiffImagePlugin import IFDRational

from splatrl.capture.base import CaptureError
from splatrl.capture.frames import buckets, read_photos, sharpness
from tests.capture.ray_cast import room_image, walk, write_video
from tests.test_images import anamorphic

PLAYLISTS = {
    "concat": "ffconcat version 1.0\nfile '{}'\n",
    "hls": "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{}\n#EXT-X-ENDLIST\n",
}


def _images(count: int) -> list[np.ndarray]:
    return [room_image(pose) for pose in walk(count)]


def _read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(float)


def test_the_sharpest_frame_of_each_interval_is_chosen(tmp_path: Path) -> None:
    images = _images(24)
    sharp = {1, 5, 9, 14, 16, 23}
    blurred = [
        image if number in sharp else np.asarray(Image.fromarray(image).filter(ImageFilter.GaussianBlur(3)))
        for number, image in enumerate(images)
    ]
    write_video(tmp_path / "a.mp4", blurred)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(6, 6))
    assert [round(10 * seconds) for seconds in photos.seconds.tolist()] == sorted(sharp)
    assert (photos.width, photos.height) == (320, 240)
    for number, path in zip(sorted(sharp), photos.paths, strict=True):
        assert np.abs(_read(path) - images[number]).mean() < 12  # the video stores colours at half the resolution


def test_the_images_of_a_film_have_times_even_if_these_are_whole_seconds(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", _images(4), rate=1)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(4, 4))
    assert photos.seconds.tolist() == [0, 1, 2, 3] and photos.files == ()


def test_frames_of_an_anamorphic_film_have_square_pixels(tmp_path: Path) -> None:
    film = anamorphic(tmp_path / "film.mkv", (96, 72), Fraction(4, 3))
    photos = read_photos(film, tmp_path / "out", count=(2, 2))
    assert (photos.width, photos.height) == (128, 72)
    assert _read(photos.paths[0])[:, :40, 0].min() > 200 > 100 > _read(photos.paths[0])[:, 46:].max()


def test_frames_that_were_trimmed_off_a_film_are_not_used(tmp_path: Path) -> None:
    write_video(tmp_path / "whole.mov", _images(24))
    with av.open(str(tmp_path / "whole.mov")) as whole, av.open(str(tmp_path / "a.mov"), "w") as trimmed:
        film = whole.streams.video[0]
        stream, before = trimmed.add_stream_from_template(film), round(1.6 / film.time_base)
        for packet in whole.demux(film):  # trimmed without re-encoding: frames before time 0 are hidden
            if packet.dts is not None:
                packet.pts, packet.dts, packet.stream = packet.pts - before, packet.dts - before, stream
                trimmed.mux(packet)
    photos = read_photos(tmp_path / "a.mov", tmp_path / "out", count=(4, 4))
    seconds = photos.seconds.tolist()
    assert [round(10 * second) // 2 for second in seconds] == [0, 1, 2, 3], "one frame of each remaining quarter"
    for second, path in zip(seconds, photos.paths, strict=True):
        assert np.abs(_read(path) - _images(24)[16 + round(10 * second)]).mean() < 12


@pytest.mark.parametrize(("level", "noise"), [(5, 4), (17, 6)])
def test_frames_of_a_covered_lens_are_left_out_where_a_phone_brightens_them_up_too(
    level: int, noise: int, tmp_path: Path
) -> None:
    random = np.random.default_rng(0)
    black = [random.normal(level, noise, (240, 320, 3)).clip(0, 255).astype(np.uint8) for _ in range(4)]
    dim = [image // 8 for image in _images(8)]
    write_video(tmp_path / "a.mp4", black + dim + black)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(16, 16))
    assert [round(10 * second) for second in photos.seconds.tolist()] == list(range(4, 12))
    write_video(tmp_path / "b.mp4", black)
    with pytest.raises(CaptureError, match=r"b\.mp4: expected decodable frames that are not black"):
        read_photos(tmp_path / "b.mp4", tmp_path / "none")


def test_black_bars_around_a_film_are_cut_off(tmp_path: Path) -> None:
    inner = _images(4)  # 320 × 240
    framed = [np.pad(image, ((0, 0), (64, 64), (0, 0))) for image in inner]
    write_video(tmp_path / "a.mp4", framed)
    photos = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(4, 4))
    assert photos.height == 240 and 310 <= photos.width < 320
    cut = (320 - photos.width) // 2
    for image, path in zip(inner, photos.paths, strict=True):
        assert np.abs(_read(path) - image[:, cut:-cut]).mean() < 12
    slate = np.full_like(framed[0], 220)  # one bright image does not hide the bars
    write_video(tmp_path / "c.mp4", [slate, *framed, *framed])
    assert read_photos(tmp_path / "c.mp4", tmp_path / "slate", count=(9, 9)).width == photos.width
    dark = [np.pad(image[100:], ((100, 0), (0, 0), (0, 0))) for image in inner]  # a night sky is no bar
    write_video(tmp_path / "b.mp4", dark)
    assert read_photos(tmp_path / "b.mp4", tmp_path / "dark", count=(4, 4)).height == 240


def test_a_second_call_reuses_the_frames_unless_the_settings_or_the_video_changed(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", _images(8))
    first = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(4, 4))
    stamp = first.paths[0].stat().st_mtime_ns
    told: list[str] = []
    again = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(4, 4), progress=lambda what, *_: told.append(what))
    assert again.paths == first.paths and again.paths[0].stat().st_mtime_ns == stamp and not told
    assert torch.equal(again.seconds, first.seconds)
    assert len(read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(5, 5)).paths) == 5
    write_video(tmp_path / "a.mp4", _images(8)[::-1])
    other = read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(5, 5))
    assert np.abs(_read(other.paths[0]) - _images(8)[0]).mean() > 10


def test_an_interrupted_read_leaves_no_files(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", _images(8))

    def stop(what: str, done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read_photos(tmp_path / "a.mp4", tmp_path / "out", count=(8, 8), progress=stop)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_frames_folder_that_holds_other_files_is_not_removed(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", _images(4))
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "mine.txt").write_text("dear")
    with pytest.raises(CaptureError, match="found other files"):
        read_photos(tmp_path / "a.mp4", tmp_path, count=(4, 4))
    assert (tmp_path / "frames" / "mine.txt").exists()


@pytest.mark.parametrize("kind", PLAYLISTS)
def test_a_playlist_disguised_as_a_video_reads_no_other_file(tmp_path: Path, kind: str) -> None:
    write_video(tmp_path / "secret.mp4", _images(4))
    (tmp_path / "a.mp4").write_text(PLAYLISTS[kind].format(tmp_path / "secret.mp4"))
    with pytest.raises(CaptureError, match="expected a complete video"):
        read_photos(tmp_path / "a.mp4", tmp_path / "out")


@pytest.mark.parametrize("content", [b"", b"no video at all", b"\x00\x00\x00\x18ftypmp42" + bytes(64)])
def test_a_file_that_is_not_a_video_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(CaptureError, match=r"a\.mp4"):
        read_photos(tmp_path / "a.mp4", tmp_path / "out")


@pytest.mark.parametrize("name", ["a.JPG", "a.heic"])
def test_a_single_photo_is_refused_with_the_advice_to_name_its_folder(name: str, tmp_path: Path) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / name, "JPEG")
    with pytest.raises(
        CaptureError, match="expected a video or a folder of photos, got a single photo; name its folder"
    ):
        read_photos(tmp_path / name, tmp_path / "out")


def test_of_too_many_photos_the_sharpest_of_each_group_is_used_and_that_is_said(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    for number in range(6):
        image = Image.fromarray(noise)
        (image if number in (1, 2, 4, 5) else image.filter(ImageFilter.GaussianBlur(3))).save(
            tmp_path / "in" / f"{number}.png"
        )
    photos = read_photos(tmp_path / "in", tmp_path / "out", count=(2, 4))
    assert photos.files == ("1.png", "2.png", "4.png", "5.png") and photos.cuts == ()
    assert photos.remarks == ("4 of 6 photos are used, the sharpest of each group of neighbours.",)
    assert read_photos(tmp_path / "in", tmp_path / "out", count=(2, 6)).remarks == ()


def test_films_among_photos_are_named_as_unused_except_those_of_live_photos(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    Image.new("RGB", (64, 48)).save(tmp_path / "in" / "IMG_1.jpg")
    (tmp_path / "in" / "IMG_1.mov").touch()
    assert read_photos(tmp_path / "in", tmp_path / "out").remarks == ()
    (tmp_path / "in" / "garden.MP4").touch()
    (remark,) = read_photos(tmp_path / "in", tmp_path / "out").remarks
    assert remark.endswith("are used, not the films: garden.MP4.")


def test_photos_are_upright_in_numeric_order_and_take_their_focal_length_from_exif(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for number in (9, 10):
        image = np.full((60, 80, 3), 10 * number, np.uint8)
        exif = Image.Exif()
        exif[0x0112] = 6  # to be rotated clockwise
        exif.get_ifd(0x8769)[0xA405] = 26
        Image.fromarray(image).save(tmp_path / "in" / f"IMG{number}.jpg", exif=exif)
    photos = read_photos(tmp_path / "in", tmp_path / "out")
    assert (photos.width, photos.height) == (60, 80) and photos.seconds.tolist() == [0, 1]
    assert [round(_read(path).mean() / 10) for path in photos.paths] == [9, 10]
    assert photos.files == ("IMG9.jpg", "IMG10.jpg") and photos.K is not None
    torch.testing.assert_close(photos.K[0, 0].item(), 26 / np.hypot(36, 24) * 100)
    assert photos.K[:2, 2].tolist() == [30, 40]


def test_photos_are_in_the_order_of_the_times_that_all_of_them_state(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()

    def write(name: str, taken: str | None, fraction: str | None = None) -> None:
        exif = Image.Exif()
        told = exif.get_ifd(0x8769)
        told.update({0x9003: taken} if taken else {})
        told.update({0x9291: fraction} if fraction else {})
        Image.new("RGB", (80, 60)).save(tmp_path / "in" / name, exif=exif)

    write("a.jpg", "2024:05:01 10:00:00", "5")
    write("b.jpg", "2024:05:01 10:00:00", "25")
    write("c10.jpg", "2024:05:01 09:59:59")
    write("c9.jpg", "2024:05:01 09:59:59")
    assert read_photos(tmp_path / "in", tmp_path / "out").files == ("c9.jpg", "c10.jpg", "b.jpg", "a.jpg")
    for unknown in (None, "0000:00:00 00:00:00"):
        write("b.jpg", unknown)
        assert read_photos(tmp_path / "in", tmp_path / "out").files == ("a.jpg", "b.jpg", "c9.jpg", "c10.jpg")


def test_photos_taken_through_several_lenses_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for number, millimetres in enumerate((26, 27, None, 26, 13)):
        exif = Image.Exif()
        if millimetres:
            exif.get_ifd(0x8769)[0xA405] = millimetres
        Image.new("RGB", (80, 60)).save(tmp_path / "in" / f"{number}.jpg", exif=exif)
    with pytest.raises(
        CaptureError, match=r"one lens without zoom.* of 26 mm .* and 13 mm in 1 photos; remove 4\.jpg$"
    ):
        read_photos(tmp_path / "in", tmp_path / "out")
    (tmp_path / "in" / "4.jpg").unlink()
    K = read_photos(tmp_path / "in", tmp_path / "out").K
    assert K is not None and K[0, 0].item() == pytest.approx(26 / np.hypot(36, 24) * 100)


def test_photos_zoomed_digitally_are_refused_even_if_their_focal_length_says_nothing_of_it(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()

    def write(zooms: tuple[float | None, ...]) -> None:
        for number, zoom in enumerate(zooms):
            exif = Image.Exif()
            exif.get_ifd(0x8769).update(
                {0xA405: 26} | ({} if zoom is None else {0xA404: IFDRational(round(10 * zoom), 10)})
            )
            Image.new("RGB", (80, 60)).save(tmp_path / "in" / f"{number}.jpg", exif=exif)

    write((1.0, 0.0, None, 2.0))
    with pytest.raises(
        CaptureError, match=r"one lens .* digital zooms of 1 \(EXIF\) and 2 in 1 photos; remove 3\.jpg$"
    ):
        read_photos(tmp_path / "in", tmp_path / "out")
    write((2.0, 2.0, 2.0, 2.0))
    K = read_photos(tmp_path / "in", tmp_path / "out").K
    assert K is not None and K[0, 0].item() == pytest.approx(26 / np.hypot(36, 24) * 100)


def test_photos_take_their_gps_positions_from_exif(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    image = Image.new("RGB", (80, 60))
    told = [{1: "N", 2: (46.0, 30.0, 36.0), 3: "W", 4: (91.0, 0.0, 18.0)}, {}, {1: "S", 2: (46.0, 30.0, 36.0)}]
    told += [{1: "S", 2: (0.0, 15.0, 0.0), 3: "E", 4: (0.0, 0.0, 36.0)}, {1: "N", 2: 46.0, 3: "E", 4: 3.0}]
    told += [{1: "N", 2: (91.0, 0.0, 0.0), 3: "E", 4: (0.0, 0.0, 36.0)}]
    told += [{1: "N", 2: (0.0, 0.0, 0.0), 3: "E", 4: (0.0, 0.0, 0.0)}]  # a camera without a fix
    for number, place in enumerate(told):
        exif = Image.Exif()
        exif.get_ifd(0x8825).update(place)
        image.save(tmp_path / "in" / f"{number}.jpg", exif=exif)
    gps = read_photos(tmp_path / "in", tmp_path / "out").gps
    unknown = (torch.nan, torch.nan)
    expected = torch.tensor([(46.51, -91.005), unknown, unknown, (-0.25, 0.01), unknown, unknown, unknown]).double()
    torch.testing.assert_close(gps, expected, equal_nan=True, atol=1e-5, rtol=0)
    for number in (0, 3):
        image.save(tmp_path / "in" / f"{number}.jpg")
    assert read_photos(tmp_path / "in", tmp_path / "out").gps is None


def test_photos_of_different_sizes_are_refused_and_the_odd_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name, size in (("a.png", (60, 80)), ("b.png", (60, 90)), ("c.png", (60, 80)), ("d.png", (60, 80))):
        Image.new("RGB", size).save(tmp_path / "in" / name)
    told = r"3 like a\.png with 60 × 80 pixels, and 1 of other sizes, like b\.png with 60 × 90; remove b\.png$"
    with pytest.raises(CaptureError, match=told):
        read_photos(tmp_path / "in", tmp_path / "out")


def test_portrait_photos_among_landscape_ones_are_turned_on_their_side(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    image = np.full((60, 80, 3), 60, np.uint8)
    image[:15, :20] = 250  # top left
    for name, turn, orientation in (("a", 0, 1), ("b", 90, 6), ("c", 90, 1), ("d", 0, 1)):  # EXIF makes b landscape
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(image).rotate(turn, expand=True).save(tmp_path / "in" / f"{name}.png", exif=exif)
    photos = read_photos(tmp_path / "in", tmp_path / "out")
    assert (photos.width, photos.height) == (80, 60)
    assert photos.turned is not None and photos.turned.tolist() == [False, False, True, False]
    for number, path in enumerate(photos.paths):
        assert _read(path)[5, 5, 0] > 200, number  # c was turned counter-clockwise, and is turned back
    assert read_photos(tmp_path / "in", tmp_path / "out").turned is not None, "the cached photos record it, too"


def test_photos_that_cannot_be_read_are_named_with_advice(tmp_path: Path) -> None:
    folder = tmp_path / "DCIM"
    folder.mkdir()
    (folder / "IMG1.HEIC").write_bytes(b"x")
    with pytest.raises(CaptureError, match=r"got IMG1\.HEIC; convert .* magick mogrify -format jpg \*\.HEIC$"):
        read_photos(folder, tmp_path / "out")
    Image.new("RGB", (80, 60)).save(folder / "IMG2.jpg")
    with pytest.raises(CaptureError, match=r"got IMG1\.HEIC; convert"):  # IMG2 is not taken for the whole set
        read_photos(folder, tmp_path / "out")
    Image.new("RGB", (80, 60)).save(folder / "IMG1.jpg")
    assert len(read_photos(folder, tmp_path / "out").paths) == 2, "IMG1 is there as a JPEG too"
    with pytest.raises(CaptureError, match=r"found none; there are some in .*DCIM, so name that folder"):
        read_photos(tmp_path, tmp_path / "out")


def test_photos_of_several_formats_are_read_together(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "old.jpg").mkdir()  # a folder, not a photo
    for number, kind in enumerate(("png", "jpg", "webp", "JPEG")):
        Image.new("RGB", (80, 60), (40 * number,) * 3).save(tmp_path / "in" / f"{number}.{kind}")
    (tmp_path / "in" / "2.webp").rename(tmp_path / "in" / "2.jpg")  # as browsers save them
    Image.new("RGB", (80, 60), (160,) * 3).save(tmp_path / "in" / "4.webp")
    photos = read_photos(tmp_path / "in", tmp_path / "out")
    assert [round(_read(path).mean() / 40) for path in photos.paths] == [0, 1, 2, 3, 4]


def test_a_folder_that_holds_a_film_instead_of_photos_is_refused_with_the_name_of_the_film(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "walk.MP4").write_bytes(b"x")
    with pytest.raises(CaptureError, match=r"found none; there is a film, .*walk\.MP4, so name that$"):
        read_photos(tmp_path / "in", tmp_path / "out")
    (tmp_path / "in" / "back.mov").write_bytes(b"x")
    with pytest.raises(CaptureError, match=r"there are 2 films, .*back\.mov, .*walk\.MP4, so name one, or first join"):
        read_photos(tmp_path / "in", tmp_path / "out")


def test_a_film_of_a_few_pixels_is_refused(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [image[::60, ::40] for image in _images(4)])
    with pytest.raises(CaptureError, match=r"expected images of at least 32 pixels along each side, got 8 × 4"):
        read_photos(tmp_path / "a.mp4", tmp_path / "out")


def test_buckets_are_four_per_second_within_the_bounds() -> None:
    for length, expected in ((10, 120), (40, 160), (300, 200)):
        times = np.arange(0, length, 1 / 30)
        assert len(buckets(times, (120, 200))) + 1 == pytest.approx(expected, abs=1)
    assert len(buckets(np.arange(7) / 30, (120, 200))) + 1 == 7


def test_a_pause_of_the_recorder_costs_no_images() -> None:
    whole, paused = np.arange(0, 20, 0.033), np.r_[0:10:0.033, 600:610:0.033]
    ends = buckets(paused, (120, 200))
    assert len(ends) == len(buckets(whole, (120, 200))) == 119
    assert np.bincount(np.searchsorted(ends, paused, side="right"), minlength=120).min() > 0
    lapse = np.arange(0, 500, 1.0)
    np.testing.assert_allclose(buckets(lapse, (120, 200)), 499 * np.arange(1, 200) / 200)


def test_a_blurred_image_is_less_sharp() -> None:
    image = Image.fromarray(_images(1)[0]).convert("L")
    assert sharpness(np.asarray(image)) > 4 * sharpness(np.asarray(image.filter(ImageFilter.GaussianBlur(2))))
