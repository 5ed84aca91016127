"""Photos of a folder: upright by their EXIF, with the focal length that it tells."""

import math
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from statistics import median_low
from typing import Any, BinaryIO

from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.capture.videos import shrunk_size
from splatrl.files import natural
from splatrl.images import PHOTO_FORMATS, PHOTO_SUFFIXES

UNREAD = (".heic", ".heif", ".avif", ".dng", ".tif", ".tiff", ".jxl")
EXIF_IFD, FOCAL_35MM, GPS_IFD = 0x8769, 0xA405, 0x8825
NAMED = 5
"""Photos that a message names, at most."""
ONE_LENS = 0.1
"""Share by which focal lengths of one lens differ at most: by their rounding, and the focus."""
DIAGONAL_35MM = math.hypot(36, 24)


def photos_of(folder: Path) -> list[Path]:
    """The photos of a folder in the order of the numbers in their names.

    Args:
        folder: to look in, not in its sub-folders.

    Raises:
        CaptureError: where there are none, or some of a kind that is not read, without the same photo as another kind.
    """
    files = [path for path in folder.iterdir() if not path.name.startswith(".") and path.is_file()]
    found = sorted((path for path in files if path.suffix.lower() in PHOTO_SUFFIXES), key=natural)
    read = {path.stem for path in found}
    unread = sorted(path.name for path in files if path.suffix.lower() in UNREAD and path.stem not in read)
    kinds = ", ".join(PHOTO_SUFFIXES)
    if unread:
        others = f" and {len(unread) - 1} others" if len(unread) > 1 else ""
        raise CaptureError(f"{folder}: expected photos ({kinds}), got {unread[0]}{others}: convert them to JPEG first")
    if not found:
        deeper = sorted({path.parent for path in folder.glob("*/*") if path.suffix.lower() in PHOTO_SUFFIXES})
        hint = f"; there are some in {deeper[0]}: name that folder" if deeper else ""
        raise CaptureError(f"{folder}: expected photos ({kinds}), found none{hint}")
    return found


def read_photo(path: Path, stream: BinaryIO | None = None, upright: bool = True) -> Image.Image:
    """Read a photo, RGB; arguments as for ``images.read_photo``.

    Raises:
        CaptureError: for a file that is broken, of another kind, or too large.
    """
    try:
        return images.read_photo(path, stream, upright)
    except ValueError as error:
        raise CaptureError(str(error)) from error


def lying(paths: list[Path], longest: int) -> list[bool]:
    """Which photos must be turned by a quarter to be of one size with most of the others.

    Args:
        paths: of all photos of a folder.
        longest: the most pixels along the longer side of what they are scaled down to.

    Raises:
        CaptureError: where some are of another size however they are turned, or cannot be read.
    """
    try:
        sizes = [shrunk_size(images.photo_size(path), longest) for path in paths]
    except ValueError as error:
        raise CaptureError(str(error)) from error
    usual = Counter(sizes).most_common(1)[0][0]
    other = [path.name for path, size in zip(paths, sizes, strict=True) if size not in (usual, usual[::-1])]
    if other:
        raise CaptureError(
            f"{paths[0].parent}: expected photos of one size from one camera, got {len(other)} of another than the "
            f"other {len(paths) - len(other)}: remove {_named(other)}"
        )
    return [size != usual for size in sizes]


def focal_length(folder: Path, size: tuple[int, int]) -> float | None:
    """The focal length that the EXIF of photos tells.

    Args:
        folder: of photos.
        size: width and height of the images that it is for, pixels.

    Returns:
        Pixels; None where no photo tells it.

    Raises:
        CaptureError: where photos were taken with several lenses, or zoomed.
    """
    told: dict[str, float] = {}
    for path in photos_of(folder):
        with suppress(OSError, SyntaxError, ValueError):
            millimetres = _exif(path, EXIF_IFD).get(FOCAL_35MM)
            if isinstance(millimetres, int | float) and millimetres > 0:
                told[path.name] = float(millimetres)
    if not told:
        return None
    usual = median_low(told.values())
    other = {name: millimetres for name, millimetres in told.items() if abs(millimetres / usual - 1) > ONE_LENS}
    if other:
        raise CaptureError(
            f"{folder}: expected photos through one lens without zoom, got {usual:g} mm (by EXIF, of 35 mm film) and "
            f"{next(iter(other.values())):g} mm in {len(other)}: remove {_named(list(other))}"
        )
    return usual / DIAGONAL_35MM * math.hypot(*size)


def gps_place(path: Path) -> tuple[float, float] | None:
    """Where the EXIF of a photo says that it was taken.

    Returns:
        Latitude and longitude, degrees, to the north and to the east positive; None where it does not tell them.
    """
    try:
        told = _exif(path, GPS_IFD)
        latitude = _degrees(told[2]) * (-1 if told[1] == "S" else 1)
        longitude = _degrees(told[4]) * (-1 if told[3] == "W" else 1)
    except (OSError, SyntaxError, ValueError, TypeError, KeyError, ZeroDivisionError):
        return None
    return (latitude, longitude) if abs(latitude) <= 90 and abs(longitude) <= 180 else None


def _named(names: list[str]) -> str:
    return ", ".join(names[:NAMED]) + (" …" if len(names) > NAMED else "")


def _exif(path: Path, directory: int) -> dict[int, Any]:
    """What a directory of a photo's EXIF holds, by tag."""
    with Image.open(path, formats=PHOTO_FORMATS) as image:
        return dict(image.getexif().get_ifd(directory))


def _degrees(told: Iterable[float]) -> float:
    """Of degrees, minutes and seconds."""
    return sum(float(part) / unit for part, unit in zip(told, (1, 60, 3600), strict=True))
