"""Photos of a folder: upright according to their EXIF, with the focal length that it states."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from numbers import Real
from pathlib import Path
from statistics import median_low
from typing import Any, BinaryIO

from PIL import Image

from splatrl import images
from splatrl.capture.base import CaptureError
from splatrl.capture.videos import shrunk_size
from splatrl.files import natural, refusing
from splatrl.images import PHOTO_FORMATS, PHOTO_SUFFIXES

# libraries for HEIF crash on some damaged files, and with them the process
UNREAD = (".heic", ".heif", ".avif", ".dng", ".tif", ".tiff", ".jxl")
FILMS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".mpg", ".3gp")
"""Suffixes of files that are named where a folder holds no photos."""
EXIF_IFD, FOCAL_35MM, DIGITAL_ZOOM, GPS_IFD, TAKEN, SUBSECOND = 0x8769, 0xA405, 0xA404, 0x8825, 0x9003, 0x9291
NAMED = 5
"""Maximum number of photos that a message names."""
ONE_LENS = 0.1
"""Maximum relative difference between focal lengths of one lens, which vary with rounding and focus, and of zooms."""
DIAGONAL_35MM = math.hypot(36, 24)


def photos_of(folder: Path) -> list[Path]:
    """Return the photos of a folder in the order in which they were taken.

    That is the order of the times in their EXIF where all of them state one, and otherwise that of the numbers in their
    names, which also orders photos of the same time.

    Args:
        folder: the folder to look in; its sub-folders are not searched.

    Raises:
        CaptureError: where there are no photos, or some of an unsupported format without a readable file of the same
            name.
    """
    files = [path for path in folder.iterdir() if not path.name.startswith(".") and path.is_file()]
    found = sorted((path for path in files if path.suffix.lower() in PHOTO_SUFFIXES), key=natural)
    read = {path.stem for path in found}
    unread = sorted(path.name for path in files if path.suffix.lower() in UNREAD and path.stem not in read)
    kinds = ", ".join(PHOTO_SUFFIXES)
    if unread:
        others = f" and {len(unread) - 1} more" if len(unread) > 1 else ""
        advice = f"convert them to JPEG first, as by: magick mogrify -format jpg *{Path(unread[0]).suffix}"
        raise CaptureError(f"{folder}: expected photos ({kinds}), got {unread[0]}{others}; {advice}")
    if not found:
        deeper = sorted({path.parent for path in folder.glob("*/*") if path.suffix.lower() in PHOTO_SUFFIXES})
        films = sorted(path for path in files if path.suffix.lower() in FILMS)
        hint = f"; there are some in {deeper[0]}, so name that folder" if deeper else ""
        hint = f"; there is a film, {films[0]}, so name that" if films else hint
        if len(films) > 1:
            several = f"{len(films)} films, {_named([str(film) for film in films])}"
            hint = f"; there are {several}, so name one, or first join takes of one camera, held the same way"
            hint += " (ffmpeg -f concat)"
        raise CaptureError(f"{folder}: expected photos ({kinds}), found none{hint}")
    times = [_time(path) for path in found]
    if all(times):
        return [path for _, path in sorted(zip(times, found, strict=True), key=lambda timed: timed[0])]
    return found


def films_beside(folder: Path) -> list[str]:
    """Return the names of the films in a folder of photos, without those that belong to a photo, as in Live Photos."""
    photos = {path.stem for path in photos_of(folder)}
    films = (path for path in folder.iterdir() if path.suffix.lower() in FILMS and not path.name.startswith("."))
    return sorted(path.name for path in films if path.is_file() and path.stem not in photos)


def read_photo(path: Path, stream: BinaryIO | None = None, upright: bool = True) -> Image.Image:
    """Read a photo as RGB; arguments as for ``images.read_photo``.

    Raises:
        CaptureError: for a file that is broken, of another kind, or too large.
    """
    with _refusing():
        return images.read_photo(path, stream, upright)


def photo_size(path: Path, upright: bool = True) -> tuple[int, int]:
    """Return the width and height of a photo; arguments as for ``images.photo_size``.

    Raises:
        CaptureError: for a file that is broken, of another kind, or too large.
    """
    with _refusing():
        return images.photo_size(path, upright)


def orientation(path: Path) -> int:
    """Return the EXIF orientation of a photo, as ``images.orientation`` does.

    Raises:
        CaptureError: for a file that is broken, of another kind, or too large.
    """
    with _refusing():
        return images.orientation(path)


def lying(paths: list[Path], longest: int) -> list[bool]:
    """Return which photos must be turned by a quarter to have the size that most of the others have.

    Args:
        paths: all photos of a folder.
        longest: maximum pixels along the longer side after scaling down.

    Raises:
        CaptureError: where some have another size whichever way they are turned, or cannot be read.
    """
    stored = [photo_size(path) for path in paths]
    sizes = [shrunk_size(size, longest) for size in stored]
    usual = Counter(sizes).most_common(1)[0][0]
    others = [number for number, size in enumerate(sizes) if size not in (usual, usual[::-1])]
    if others:
        (width, height), (other_width, other_height) = stored[sizes.index(usual)], stored[others[0]]
        raise CaptureError(
            f"{paths[0].parent}: expected photos of one size from one camera, got {len(paths) - len(others)} like "
            f"{paths[sizes.index(usual)].name} with {width} × {height} pixels, and {len(others)} of other sizes, like "
            f"{paths[others[0]].name} with {other_width} × {other_height}; remove "
            f"{_named([paths[number].name for number in others])}"
        )
    return [size != usual for size in sizes]


def focal_length(folder: Path, size: tuple[int, int]) -> float | None:
    """Return the focal length that the EXIF of photos states.

    Args:
        folder: the folder of the photos.
        size: width and height of the images that the focal length is for, pixels.

    Returns:
        Pixels; None where no photo states it.

    Raises:
        CaptureError: where photos were taken with several lenses, or zoomed.
    """
    lengths: dict[str, float] = {}
    zooms: dict[str, float] = {}
    for path in photos_of(folder):
        with suppress(OSError, ValueError):
            told = _exif(path, EXIF_IFD)
            if told:
                zooms[path.name] = _number(told.get(DIGITAL_ZOOM)) or 1.0  # 0 stands for none
            if (millimetres := _number(told.get(FOCAL_35MM))) > 0:
                lengths[path.name] = millimetres
    _usual(folder, zooms, "digital zooms of {:g} (EXIF) and {:g}")  # only some phones multiply the focal length by it
    usual = _usual(folder, lengths, "focal lengths of {:g} mm (EXIF, 35 mm equivalent) and {:g} mm")
    return None if usual is None else usual / DIAGONAL_35MM * math.hypot(*size)


def gps_place(path: Path) -> tuple[float, float] | None:
    """Return where a photo was taken according to its EXIF.

    Returns:
        Latitude and longitude, degrees, positive to the north and to the east; None where EXIF does not state them, or
        states 0 for both, as cameras without a fix do.
    """
    try:
        told = _exif(path, GPS_IFD)
        latitude = _degrees(told[2]) * (-1 if told[1] == "S" else 1)
        longitude = _degrees(told[4]) * (-1 if told[3] == "W" else 1)
    except (OSError, ValueError, TypeError, KeyError, ZeroDivisionError):
        return None
    known = abs(latitude) <= 90 and abs(longitude) <= 180 and (latitude, longitude) != (0, 0)
    return (latitude, longitude) if known else None


@contextmanager
def _refusing() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise CaptureError(str(error)) from error


def _named(names: list[str]) -> str:
    return ", ".join(names[:NAMED]) + (" …" if len(names) > NAMED else "")


def _usual(folder: Path, told: dict[str, float], two: str) -> float | None:
    """Return the median of what photos state, by their names; None where none does.

    Args:
        folder: the folder of the photos.
        told: the value of each photo that states one, positive.
        two: words for two values that differ.

    Raises:
        CaptureError: where the values of some photos differ too much for one lens.
    """
    if not told:
        return None
    usual = median_low(told.values())
    other = {name: value for name, value in told.items() if abs(value / usual - 1) > ONE_LENS}
    if other:
        raise CaptureError(
            f"{folder}: expected photos taken with one lens without zooming, got "
            f"{two.format(usual, next(iter(other.values())))} in {len(other)} photos; remove {_named(list(other))}"
        )
    return usual


def _number(told: Any) -> float:
    """Return a number that EXIF states; 0 for anything else."""
    number = float(told) if isinstance(told, Real) else 0.0
    return number if math.isfinite(number) else 0.0


def _exif(path: Path, directory: int) -> dict[int, Any]:
    """Return the tags of one directory in a photo's EXIF; ValueError for what cannot be read."""
    with refusing(path, "a photo with or without EXIF"), Image.open(path, formats=PHOTO_FORMATS) as image:
        return dict(image.getexif().get_ifd(directory))


def _time(path: Path) -> str:
    """Return when a photo was taken, as text that sorts by time; empty where EXIF does not state it."""
    with suppress(OSError, ValueError):
        told = _exif(path, EXIF_IFD)
        taken = told.get(TAKEN)
        if isinstance(taken, str) and any(digit in taken for digit in "123456789"):
            return f"{taken.strip()}.{told.get(SUBSECOND, '')}"
    return ""


def _degrees(told: Iterable[float]) -> float:
    """Convert degrees, minutes and seconds to degrees."""
    return sum(float(part) / unit for part, unit in zip(told, (1, 60, 3600), strict=True))
