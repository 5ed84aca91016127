"""Photos and videos from strangers: only kinds that cannot point at other files, and none too large."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageChops, ImageOps

from splatrl.files import refusing

if TYPE_CHECKING:
    from av.container import InputContainer

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
PHOTO_FORMATS = ("PNG", "JPEG", "WEBP")
"""Pillow's names of them."""
CONTAINERS = ("mov", "matroska", "webm", "avi", "mpegts", "mpeg", "mpegvideo", "flv", "asf", "ogg", "mxf", "gif", "ivf")
"""FFmpeg's names of them. Playlists (concat, hls, dash) are absent: a script of one may name any file of the disk."""
ORIENTATION = 0x0112
"""The tag of EXIF."""
MAX_PIXELS = 64 * 2**20
"""Of one image: more than any phone takes."""
MOST_OBLONG = 4.0
"""Longer side of a video's pixels over the shorter one, at most; those of anamorphic lenses have 2."""


def read_photo(path: Path, stream: BinaryIO | None = None, upright: bool = True) -> Image.Image:
    """Read a photo, RGB: of 16 bits the higher eight, and black where it is transparent.

    Args:
        path: of a PNG, a JPEG or a WebP.
        stream: to read from, such as an entry of an archive, which ``path`` then only names.
        upright: whether to turn it as its EXIF says; False leaves it as the intrinsics of a recording describe it.

    Raises:
        ValueError: for a file that is broken, of another kind, or too large.
    """
    with _opened(path, stream, PHOTO_FORMATS) as image:
        if upright:
            ImageOps.exif_transpose(image, in_place=True)
        return _rgb(image)


def _rgb(image: Image.Image) -> Image.Image:
    """What an image shows; Pillow alone makes most of 16 bits white, and shows what is hidden."""
    if image.mode.startswith("I;16"):
        return Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert("RGB")
    if not image.has_transparency_data:
        return image.convert("RGB")
    image = image if "A" in image.mode else image.convert("RGBA")
    shown = image.convert("RGB")
    shown.paste("black", mask=ImageChops.invert(image.getchannel("A")))
    return shown


def photo_size(path: Path) -> tuple[int, int]:
    """Width and height of a photo once it is upright, pixels, without reading its pixels.

    Args:
        path: of a PNG, a JPEG or a WebP.

    Raises:
        ValueError: for a file that is broken, of another kind, or too large.
    """
    with _opened(path, None, PHOTO_FORMATS) as image:
        lies = image.getexif().get(ORIENTATION) in (5, 6, 7, 8)
        return (image.height, image.width) if lies else image.size


def read_grey(path: Path) -> NDArray[Any]:
    """Read a picture of whole numbers, such as measured depth.

    Args:
        path: of a PNG with one channel of 8 or 16 bits.

    Returns:
        [H, W] uint8 or uint16.

    Raises:
        ValueError: for a file that is broken, of another kind, or too large.
    """
    with _opened(path, None, ("PNG",)) as image:
        if image.mode not in ("L", "I;16"):
            raise ValueError(f"expected one channel of 8 or 16 bits, got the mode {image.mode}")
        return np.array(image)


@contextmanager
def _opened(path: Path, stream: BinaryIO | None, formats: tuple[str, ...]) -> Iterator[Image.Image]:
    """An image whose pixels are not yet read, and are not too many; every fault names the path."""
    with refusing(path, f"a whole {' or '.join(formats)}"), Image.open(stream or path, formats=formats) as image:
        require_small(path, image.width, image.height)  # in the header, before anything is decoded
        yield image


@contextmanager
def open_video(path: Path) -> Iterator["InputContainer"]:
    """Open a video.

    Args:
        path: of the file.

    Raises:
        ValueError: where it cannot be read, is not a video in one of ``CONTAINERS``, or has too large images or too
            oblong pixels.
    """
    import av

    options = {"protocol_whitelist": "file", "format_whitelist": ",".join(CONTAINERS)}
    whole = f"a whole video ({', '.join(CONTAINERS)})"
    with refusing(path, whole), av.open(str(path.resolve()), container_options=options) as container:
        if not set(container.format.name.split(",")) & set(CONTAINERS):
            raise ValueError(f"{path}: expected a video, got the format {container.format.name}")
        if not container.streams.video:
            raise ValueError(f"{path}: expected a video, found no stream of images")
        track = container.streams.video[0]
        aspect = pixel_aspect(container)
        if not 1.0 / MOST_OBLONG <= aspect <= MOST_OBLONG:
            raise ValueError(f"{path}: expected pixels about as wide as high, got {track.sample_aspect_ratio}")
        require_small(path, *square_size(track.width, track.height, aspect))
        track.codec_context.options = {"max_pixels": str(MAX_PIXELS)}  # images may say more than their container
        yield container


def pixel_aspect(container: "InputContainer") -> float:
    """How wide a video's pixels are meant to be shown, in heights of them: 1 unless it is anamorphic."""
    return float(container.streams.video[0].sample_aspect_ratio or 1)


def square_size(width: int, height: int, aspect: float) -> tuple[int, int]:
    """Width and height of an image with square pixels, none fewer than it has in any direction."""
    return (round(width * aspect), height) if aspect > 1.0 else (width, round(height / aspect))


def square_pixels(image: Image.Image, aspect: float) -> Image.Image:
    """An image of a video of some ``pixel_aspect`` as it is meant to be shown."""
    size = square_size(*image.size, aspect)
    return image if size == image.size else image.resize(size, Image.Resampling.BILINEAR)


def require_small(path: Path, width: int, height: int) -> None:
    """Refuse images of more than ``MAX_PIXELS``.

    Raises:
        ValueError: naming the file.
    """
    if width * height > MAX_PIXELS:
        raise ValueError(f"{path}: expected images of at most {MAX_PIXELS:,} pixels, got {width} × {height}")
