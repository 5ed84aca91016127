"""Untrusted photos and videos: only formats that cannot refer to other files, and only up to a maximum size."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageChops, ImageOps

from splatrl.files import refusing

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
PHOTO_FORMATS = ("PNG", "JPEG", "WEBP")
"""Pillow's names for these formats."""
CONTAINERS = ("mov", "matroska", "webm", "avi", "mpegts", "mpeg", "mpegvideo", "flv", "asf", "ogg", "mxf", "gif", "ivf")
"""FFmpeg's names of allowed containers. Playlists (concat, hls, dash) are not: they can name any file on the disk."""
ORIENTATION = 0x0112
"""EXIF tag of the orientation."""
MAX_PIXELS = 64 * 2**20
"""Maximum number of pixels in one image, more than any phone takes."""
UNNAMED, HD = 2, (1280, 720)
"""FFmpeg's number of a colour matrix that a file does not name, and the width or height from which it is then BT.709,
not BT.601."""
MOST_OBLONG = 4.0
"""Maximum aspect ratio of a video's pixels, longer side over shorter; anamorphic lenses have 2."""


def read_photo(path: Path, stream: BinaryIO | None = None, upright: bool = True) -> Image.Image:
    """Read a photo as RGB; 16-bit channels keep their upper eight bits, and transparent pixels become black.

    Args:
        path: path of a PNG, JPEG or WebP.
        stream: stream to read from, such as an entry of an archive; ``path`` then only names it in messages.
        upright: whether to rotate the photo as its EXIF says; False leaves it in the orientation that a recording's
            intrinsics describe.

    Raises:
        ValueError: for a file that is damaged, in another format, or too large.
    """
    with _opened(path, stream, PHOTO_FORMATS) as image:
        if upright:
            ImageOps.exif_transpose(image, in_place=True)
        return _rgb(image)


def _rgb(image: Image.Image) -> Image.Image:
    """Convert to RGB with transparent pixels in black; Pillow alone shows their colours."""
    image = eight_bits(image)
    if not image.has_transparency_data:
        return image.convert("RGB")
    image = image if "A" in image.mode else image.convert("RGBA")
    shown = image.convert("RGB")
    shown.paste("black", mask=ImageChops.invert(image.getchannel("A")))
    return shown


def eight_bits(image: Image.Image) -> Image.Image:
    """Reduce 16-bit grey to its upper eight bits, with alpha if one grey is transparent; return others as they are.

    Pillow alone turns most 16-bit values white.
    """
    if not image.mode.startswith("I;16"):
        return image
    grey = np.asarray(image)
    reduced = Image.fromarray((grey >> 8).astype(np.uint8))
    if image.has_transparency_data:
        reduced.putalpha(Image.fromarray(np.where(grey == image.info["transparency"], 0, 255).astype(np.uint8)))
    return reduced


def photo_size(path: Path, upright: bool = True) -> tuple[int, int]:
    """Return a photo's width and height in pixels, without decoding it.

    Args:
        path: path of a PNG, JPEG or WebP.
        upright: whether to return the size that it has once it is rotated as its EXIF says.

    Raises:
        ValueError: for a file that is damaged, in another format, or too large.
    """
    with _opened(path, None, PHOTO_FORMATS) as image:
        lies = upright and image.getexif().get(ORIENTATION) in (5, 6, 7, 8)
        return (image.height, image.width) if lies else image.size


def orientation(path: Path) -> int:
    """Return how a photo is to be rotated or mirrored, as EXIF numbers it: 1 to 8, where 1 is not at all.

    Args:
        path: path of a PNG, JPEG or WebP.

    Raises:
        ValueError: for a file that is damaged, in another format, or too large.
    """
    with _opened(path, None, PHOTO_FORMATS) as image:
        told = image.getexif().get(ORIENTATION)
        return told if isinstance(told, int) and 1 <= told <= 8 else 1


def read_grey(path: Path) -> NDArray[Any]:
    """Read a one-channel integer image, such as measured depth.

    Args:
        path: path of a PNG with one channel of 8 or 16 bits.

    Returns:
        [H, W] uint8 or uint16.

    Raises:
        ValueError: for a file that is damaged, in another format, or too large.
    """
    with _opened(path, None, ("PNG",)) as image:
        if image.mode not in ("L", "I;16"):
            raise ValueError(f"expected one channel of 8 or 16 bits, got mode {image.mode}")
        return np.array(image)


@contextmanager
def _opened(path: Path, stream: BinaryIO | None, formats: tuple[str, ...]) -> Iterator[Image.Image]:
    """Open an image without decoding it, check its size, and name the path in every error."""
    with refusing(path, f"a complete {' or '.join(formats)}"), Image.open(stream or path, formats=formats) as image:
        require_small(path, image.width, image.height)  # from the header, before decoding
        yield image


@contextmanager
def open_video(path: Path) -> Iterator["InputContainer"]:
    """Open a video.

    Args:
        path: path of the file.

    Raises:
        ValueError: if it cannot be read, is not a video in one of ``CONTAINERS``, or if its images are too large or its
            pixels too elongated.
    """
    import av

    options = {"protocol_whitelist": "file", "format_whitelist": ",".join(CONTAINERS)}
    whole = f"a complete video ({', '.join(CONTAINERS)})"
    with refusing(path, whole), av.open(str(path.resolve()), container_options=options) as container:
        if not set(container.format.name.split(",")) & set(CONTAINERS):
            raise ValueError(f"{path}: expected a video, got the format {container.format.name}")
        if not _moving(container):
            raise ValueError(f"{path}: expected a video, found no video stream")
        track = video_track(container)
        aspect = pixel_aspect(container)
        if not 1.0 / MOST_OBLONG <= aspect <= MOST_OBLONG:
            raise ValueError(
                f"{path}: expected nearly square pixels, got an aspect ratio of {track.sample_aspect_ratio}"
            )
        require_small(path, *square_size(track.width, track.height, aspect))
        track.codec_context.options = {"max_pixels": str(MAX_PIXELS)}  # frames may be larger than the container says
        yield container


def video_track(container: "InputContainer") -> "VideoStream":
    """Return the video track with the most pixels, the first of equals: files may hold a small copy for previews.

    A track of a single frame is a still, and taken only where there is no other.
    """
    return max(_moving(container), key=lambda track: (track.frames != 1, track.width * track.height))


def _moving(container: "InputContainer") -> list["VideoStream"]:
    """Return the video tracks that are not the file's cover picture."""
    from av.stream import Disposition

    return [track for track in container.streams.video if not track.disposition & Disposition.attached_pic]


def pixel_aspect(container: "InputContainer") -> float:
    """Return the width-to-height ratio at which a video's pixels are meant to be shown: 1 unless it is anamorphic."""
    return float(video_track(container).sample_aspect_ratio or 1)


def square_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """Return an image's width and height after resampling to square pixels; neither side gets smaller."""
    return (round(width * aspect), height) if aspect > 1.0 else (width, round(height / aspect))


def square_pixels(image: Image.Image, aspect: float) -> Image.Image:
    """Resample a video frame with a given ``pixel_aspect`` to square pixels."""
    size = square_size(*image.size, aspect)
    return image if size == image.size else image.resize(size, Image.Resampling.BILINEAR)


def one_field(image: Image.Image) -> Image.Image:
    """Return every other line of an interlaced frame, whose lines in between were taken at another time."""
    return Image.fromarray(np.asarray(image)[::2])


def displayed(frame: "VideoFrame", aspect: float) -> Image.Image:
    """Return a video frame as players show it: RGB, with square pixels, and turned or mirrored as the file says.

    Of an interlaced frame, one of the two fields is shown. The levels of a frame of high dynamic range are those that
    the file stores; ``usual_range`` converts them, faster once the image is small.

    Args:
        frame: the frame as decoded.
        aspect: the video's ``pixel_aspect``.
    """
    image = in_colour(frame)
    image = square_pixels(one_field(image), aspect / 2) if frame.interlaced_frame else square_pixels(image, aspect)
    told: Any = frame.side_data  # PyAV's stubs know only motion vectors
    if (matrix := told.get("DISPLAYMATRIX")) is None:
        return image
    a, b, _, c, d, *_ = np.frombuffer(matrix, np.int32).tolist()
    if a * d < b * c:  # a mirror image, whose rotation FFmpeg takes from the horizontal axis alone
        image = image.transpose(Image.Transpose.FLIP_TOP_BOTTOM)
    return image.rotate(frame.rotation, expand=True)


def in_colour(frame: "VideoFrame") -> Image.Image:
    """Return a video frame as RGB; where its file does not name its colour matrix, that of its size, as players do."""
    from av.video.reformatter import Colorspace

    large = frame.width >= HD[0] or frame.height >= HD[1]
    return frame.to_image(src_colorspace=Colorspace.ITU709 if frame.colorspace == UNNAMED and large else None)


def require_small(path: Path, width: int, height: int) -> None:
    """Refuse images with more than ``MAX_PIXELS`` pixels.

    Raises:
        ValueError: names the file.
    """
    if width * height > MAX_PIXELS:
        raise ValueError(f"{path}: expected images of at most {MAX_PIXELS:,} pixels, got {width} × {height}")
