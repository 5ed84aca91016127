"""Photos and videos from strangers: each kind looks as intended, and images that exceed their declared size fail."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import Colorspace
from PIL import Image

from splatrl import images
from splatrl.evaluation.clip_files import film_images
from splatrl.evaluation.encoding import encode


def _coded(side: int) -> list[av.Packet]:
    """Return the packets of an MPEG-2 image, which state its size."""
    coder = av.CodecContext.create("mpeg2video", "w")
    coder.width, coder.height, coder.pix_fmt, coder.framerate = side, side, "yuv420p", 25
    frame = av.VideoFrame.from_ndarray(np.full((side, side, 3), 90, np.uint8))
    return [*coder.encode(frame), *coder.encode(None)]


def decoded(packet: av.Packet) -> list[av.VideoFrame]:
    try:
        return packet.decode()
    except av.error.FFmpegError:
        return []


def test_an_image_that_is_larger_than_its_file_declares_is_not_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as container:
        track = container.add_stream("mpeg2video", rate=25)
        track.width, track.height, track.pix_fmt = 32, 32, "yuv420p"
        for number, packet in enumerate([*_coded(32), *_coded(32), *_coded(256)]):
            packet.stream, packet.pts, packet.dts = track, number, number
            container.mux(packet)
    monkeypatch.setattr(images, "MAX_PIXELS", 64 * 64)
    with images.open_video(path) as film:
        assert {frame.width for packet in film.demux(video=0) for frame in decoded(packet)} == {32}
    with pytest.raises(ValueError, match=r"film\.mkv: expected"):
        list(film_images(path))
    monkeypatch.setattr(images, "MAX_PIXELS", 256 * 256)
    assert {image.size for image in film_images(path)} == {(32, 32), (256, 256)}


RAMP = np.linspace(0, 255, 12).round().astype(np.uint8)[:, None].repeat(8, 1)
"""[12, 8] uint8, dark at the top and bright at the bottom."""


def test_a_16_bit_grey_photo_shows_its_upper_eight_bits(tmp_path: Path) -> None:
    Image.fromarray(RAMP.astype(np.uint16) * 256 + 77).save(tmp_path / "a.png")
    assert np.array_equal(np.asarray(images.read_photo(tmp_path / "a.png")), RAMP[..., None].repeat(3, 2))


@pytest.mark.parametrize("kind", ["RGBA", "LA", "P"])
def test_transparent_pixels_are_black_whatever_colour_they_hide(kind: str, tmp_path: Path) -> None:
    alpha = np.full_like(RAMP, 255)
    alpha[:3], alpha[3:6] = 0, 128
    colors = np.concatenate([RAMP[..., None].repeat(3, 2), alpha[..., None]], 2)
    colors[:3, :, 1] = 250  # hidden by an alpha of 0
    image = Image.fromarray(colors)
    if kind == "P":
        image = image.quantize(256, Image.Quantize.FASTOCTREE)
    (image.convert("LA") if kind == "LA" else image).save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as written:
        assert written.mode == kind
    shown = np.asarray(images.read_photo(tmp_path / "a.png")).astype(int)
    assert shown[:3].max() <= 2
    assert np.abs(shown[3:6] - RAMP[3:6, :, None] * 0.5).max() <= 4 and np.abs(shown[6:] - RAMP[6:, :, None]).max() <= 6


@pytest.mark.parametrize("orientation", range(1, 9))
def test_photos_are_upright_however_the_camera_was_held(orientation: int, tmp_path: Path) -> None:
    stored = {
        2: Image.Transpose.FLIP_LEFT_RIGHT,
        3: Image.Transpose.ROTATE_180,
        4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE,
        6: Image.Transpose.ROTATE_90,
        7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }
    upright = np.stack([RAMP, RAMP // 2, np.linspace(0, 90, 8).astype(np.uint8)[None].repeat(12, 0)], 2)
    image, exif = Image.fromarray(upright), Image.Exif()
    exif[images.ORIENTATION] = orientation
    (image.transpose(stored[orientation]) if orientation > 1 else image).save(tmp_path / "a.png", exif=exif)
    assert np.array_equal(np.asarray(images.read_photo(tmp_path / "a.png")), upright)
    assert images.photo_size(tmp_path / "a.png") == (8, 12)


def anamorphic(path: Path, size: tuple[int, int], aspect: Fraction) -> Path:
    """Write a lossless RGB film with this pixel aspect ratio, whose left third is red."""
    pixels = np.full((size[1], size[0], 3), 60, np.uint8)
    pixels[:, : size[0] // 3] = (250, 20, 20)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264rgb", rate=10, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = *size, "rgb24"
        stream.codec_context.sample_aspect_ratio = aspect
        for _ in range(6):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels)))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(("aspect", "shown"), [("4/3", (128, 72)), ("1/2", (96, 144)), ("1", (96, 72))])
def test_anamorphic_films_are_shown_with_square_pixels(aspect: str, shown: tuple[int, int], tmp_path: Path) -> None:
    path = anamorphic(tmp_path / "film.mkv", (96, 72), Fraction(aspect))
    for image in film_images(path):
        pixels = np.asarray(image).astype(int)
        assert image.size == shown
        assert pixels[:, : shown[0] // 3 - 2, 0].min() > 240 and pixels[:, shown[0] // 3 + 2 :].max() < 70


@pytest.mark.parametrize(("height", "matrix"), [(480, Colorspace.ITU601), (720, Colorspace.ITU709)])
def test_the_colours_of_a_film_that_does_not_name_its_matrix_are_those_of_its_size(
    height: int, matrix: Colorspace, tmp_path: Path
) -> None:
    red = av.VideoFrame.from_ndarray(np.full((height, 64, 3), (255, 0, 0), np.uint8))
    with av.open(str(tmp_path / "film.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = 64, height, "yuv420p"
        frame = red.reformat(format="yuv420p", dst_colorspace=matrix)
        container.mux([*stream.encode(frame), *stream.encode(None)])
    (image,) = film_images(tmp_path / "film.mp4")
    np.testing.assert_allclose(image.getpixel((32, 32)), (255, 0, 0), atol=3)


def test_a_film_of_ours_names_its_colour_matrix(tmp_path: Path) -> None:
    encode([Image.new("RGB", (64, 720), (255, 0, 0))], tmp_path / "film.mp4", 10)
    (image,) = film_images(tmp_path / "film.mp4")
    np.testing.assert_allclose(image.getpixel((32, 32)), (255, 0, 0), atol=3)


def test_a_film_whose_pixels_are_far_from_square_is_refused(tmp_path: Path) -> None:
    path = anamorphic(tmp_path / "film.mkv", (96, 72), Fraction(60, 1))
    with pytest.raises(ValueError, match=r"film\.mkv: expected nearly square pixels, got an aspect ratio of 60"):
        list(film_images(path))
