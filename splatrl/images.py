"""Photos and videos from strangers: only kinds that cannot point at other files, and none too large."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

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


def read_photo(path: Path, stream: BinaryIO | None = None, upright: bool = True) -> Image.Image:
    """Read a photo, RGB.

    Args:
        path: of a PNG, a JPEG or a WebP.
        stream: to read from, such as an entry of an archive, which ``path`` then only names.
        upright: whether to turn it as its EXIF says; False leaves it as the intrinsics of a recording describe it.

    Raises:
        ValueError: for a file that is broken, of another kind, or too large.
    """
    with _opened(path, stream, PHOTO_FORMATS) as image:
        return (ImageOps.exif_transpose(image) if upright else image).convert("RGB")


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
        ValueError: where it cannot be read, is not a video in one of ``CONTAINERS``, or has too large images.
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
        require_small(path, track.width, track.height)
        track.codec_context.options = {"max_pixels": str(MAX_PIXELS)}  # images may say more than their container
        yield container


def require_small(path: Path, width: int, height: int) -> None:
    """Refuse images of more than ``MAX_PIXELS``.

    Raises:
        ValueError: naming the file.
    """
    if width * height > MAX_PIXELS:
        raise ValueError(f"{path}: expected images of at most {MAX_PIXELS:,} pixels, got {width} × {height}")
