"""First stage: the sharpest images of a video or of a folder of photos, upright and all of one size."""

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
from PIL import Image

from splatrl.capture import photo_files, videos
from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.cuts import coarse, cuts, pattern
from splatrl.capture.pauses import STEP, small, views, without_pauses
from splatrl.capture.progress import Progress, silent
from splatrl.capture.stages import Stages, fingerprint
from splatrl.images import PHOTO_SUFFIXES
from splatrl.values import require_number

if TYPE_CHECKING:
    from av import VideoFrame

INDEX = "index.json"
PER_SECOND = 1.0 / STEP
"""Frames to take per second of video, unless the wanted minimum is more, or the maximum less."""
SHARPNESS_WIDTH = 480
SMALLEST = 32
"""Minimum side of an image, pixels; smaller ones show no features."""
BLACK, DARK, EVEN = 10.0, 25.0, 1.5
"""Mean grey level below which a video frame shows nothing: the lens was covered, or clips fade into each other. And the
level below which it shows nothing but noise if, over coarse pixels, it deviates by less than ``EVEN``, as in a pocket
that the phone brightens up. Films of rooms and yards that are darkened to a level of 12 deviate by 2.2 or more."""
Thing = TypeVar("Thing")


@dataclass(frozen=True)
class _Taken:
    image: Image.Image
    seconds: float
    file: str | None = None
    gps: tuple[float, float] | None = None
    turned: bool = False


@dataclass(frozen=True)
class _Told:
    """What is known of a source once its images were taken, as in ``Photos``, and when each view of it begins."""

    remarks: list[str] = field(default_factory=list)
    cuts: list[float] = field(default_factory=list)
    views: list[float] = field(default_factory=list)


def read_photos(
    source: Path, folder: Path, count: tuple[int, int] = (120, 200), longest: int = 960, progress: Progress = silent
) -> Photos:
    """Select the sharpest frames of a video, except black ones, or the photos of a folder, and keep them.

    Pauses, in which the camera stands still, take hardly any of a video's frames: see ``pauses``.

    A second call with the same source and settings reads what the first one kept. Landscape photos among portrait ones,
    or vice versa, are turned to the size that most photos have.

    Args:
        source: a video, or a folder of photos (PNG, JPEG, WebP).
        folder: the capture's folder; the images are written to its sub-folder ``frames``.
        count: minimum (where the video has so many) and maximum number of images.
        longest: maximum pixels along the longer side.
        progress: called for every frame or photo.

    Returns:
        The images in the order in which they were taken; with K where EXIF gives a focal length (a first guess: it is
        rounded to a millimetre), and with GPS positions where EXIF gives them.

    Raises:
        CaptureError: where the source cannot be read, or its images are not of one size and one lens.
        ValueError: for settings that make no sense.
    """
    if not 1 <= count[0] <= count[1]:
        raise ValueError(f"count: expected (minimum, maximum) with 1 ≤ minimum ≤ maximum, got {count}")
    require_number("longest", longest, 16, whole=True, unit="pixels")
    if not source.exists():
        raise CaptureError(f"{source}: expected a video or a folder of photos, found none")
    if source.is_file() and source.suffix.lower() in (*PHOTO_SUFFIXES, *photo_files.UNREAD):
        raise CaptureError(f"{source}: expected a video or a folder of photos, got a single photo; name its folder")

    def write(made: Path) -> None:
        if source.is_dir():
            told = _Told()
            _write(made, _from_folder(source, count, longest, progress, told), source, told)
        else:
            _write_film(made, source, count, longest, progress)

    films = photo_files.films_beside(source) if source.is_dir() else []
    files = photo_files.photos_of(source) if source.is_dir() else [source]
    key = fingerprint([count, longest, films], files=files)
    return _photos(Stages(folder).folder("frames", key, write))


def sharpness(grey: np.ndarray) -> float:
    """Return the variance of the Laplacian of a grey image [H, W]: the larger, the sharper."""
    grey = grey.astype(np.float32)
    around = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:]
    return float((around - 4 * grey[1:-1, 1:-1]).var())


def shows_something(grey: np.ndarray) -> bool:
    """Return whether a video frame [H, W] uint8 shows more than black, or than the noise of a covered lens."""
    return bool(grey.mean() >= DARK or (grey.mean() >= BLACK and coarse(grey).std() >= EVEN))


def buckets(times: np.ndarray, count: tuple[int, int], begun: Sequence[float] = ()) -> np.ndarray:
    """Split a video into stretches of equal duration, for which pauses do not count.

    Args:
        times: [N] timestamps of its frames, seconds, ascending.
        count: minimum and maximum number of stretches.
        begun: times at which another view begins, as ``views`` returns them; empty where they are unknown.

    Returns:
        [M - 1] end times of all stretches but the last; M is at most the number of frames.
    """
    clock = without_pauses(times, begun)
    length = clock[-1] - clock[0]
    most = min(max(count[0], math.ceil(PER_SECOND * length)), count[1], len(times))
    ends: np.ndarray = clock[0] + length * np.arange(1, most) / most
    return ends if clock is times else np.interp(ends, clock, times)


def sharpest(graded: Iterable[tuple[int, Thing, float]]) -> Iterator[Thing]:
    """Yield the sharpest image of each bucket.

    Args:
        graded: bucket, image and sharpness, grouped by bucket; the first of equally sharp images wins.
    """
    for _, group in itertools.groupby(graded, key=lambda grade: grade[0]):
        best, best_sharpness = None, -math.inf
        for _, thing, value in group:  # one at a time, because video frames are large
            if value > best_sharpness:
                best, best_sharpness = thing, value
        if best is not None:
            yield best


def _write_film(made: Path, source: Path, count: tuple[int, int], longest: int, progress: Progress) -> None:
    """Write the images of a film; once more where the camera stood still, which is known only at its end."""
    times, told = videos.packet_times(source), _Told()
    evenly = buckets(times, count)
    _write(made, _from_video(source, times, evenly, longest, progress, told), source, told)
    moving = buckets(times, count, told.views)
    if not np.array_equal(moving, evenly):
        for path in made.iterdir():
            path.unlink()
        told = _Told()
        _write(made, _from_video(source, times, moving, longest, progress, told), source, told)


def _from_video(
    source: Path, times: np.ndarray, ends: np.ndarray, longest: int, progress: Progress, told: _Told
) -> Iterator[_Taken]:
    aspect, start, found = videos.aspect_of(source), float(times[0]), False
    shown: list[float] = []
    patterns: list[np.ndarray] = []
    seen: list[float] = []
    smalls: list[np.ndarray] = []

    def graded() -> Iterator[tuple[int, tuple[float, "VideoFrame"], float]]:
        for number, (seconds, frame) in enumerate(videos.frames(source, told.remarks.append)):
            progress("frames", min(number, len(times)), len(times))
            grey = videos.grey(frame, SHARPNESS_WIDTH)
            shown.append(seconds - start)
            patterns.append(pattern(grey))
            if shows_something(grey):
                seen.append(seconds)
                smalls.append(small(grey))
                yield int(np.searchsorted(ends, seconds, side="right")), (seconds, frame), sharpness(grey)

    for seconds, frame in sharpest(graded()):
        found = True
        yield _Taken(videos.upright(frame, longest, aspect), seconds - start)
    if not found:
        raise CaptureError(f"{source}: expected decodable frames that are not black, found none")
    told.cuts.extend(cuts(shown, patterns))
    told.views.extend(views(seen, smalls))
    progress("frames", len(times), len(times))


def _from_folder(
    source: Path, count: tuple[int, int], longest: int, progress: Progress, told: _Told
) -> Iterator[_Taken]:
    paths = photo_files.photos_of(source)
    if films := photo_files.films_beside(source):
        told.remarks.append(f"Only the photos in {source} are used, not the films: {', '.join(films)}.")
    lying = photo_files.lying(paths, longest)
    groups = np.array_split(np.arange(len(paths)), min(len(paths), count[1]))
    if len(groups) < len(paths):
        told.remarks.append(f"{len(groups)} of {len(paths)} photos are used, the sharpest of each group of neighbours.")

    def graded() -> Iterator[tuple[int, _Taken, float]]:
        for bucket, group in enumerate(groups):
            for number in group.tolist():
                progress("photos", number, len(paths))
                image = videos.shrunk(photo_files.read_photo(paths[number]), longest)
                if lying[number]:
                    image = image.transpose(Image.Transpose.ROTATE_270)  # clockwise
                value = sharpness(np.asarray(image.convert("L"))) if len(group) > 1 else 0.0
                place = photo_files.gps_place(paths[number])
                yield bucket, _Taken(image, float(number), paths[number].name, place, lying[number]), value

    yield from sharpest(graded())
    progress("photos", len(paths), len(paths))


def _write(made: Path, taken: Iterator[_Taken], source: Path, told: _Told) -> None:
    """Write the images and what is known of them; ``told`` is complete once all images were taken."""
    names, seconds, files, gps, turned = [], [], [], [], []
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    for number, photo in enumerate(taken):
        grey = np.asarray(photo.image.convert("L"))
        rows.append(grey.max(1))
        columns.append(grey.max(0))
        names.append(f"{number:04}.jpg")
        photo.image.convert("RGB").save(made / names[-1], quality=95, subsampling=0)
        seconds.append(photo.seconds)
        files += [photo.file] if photo.file is not None else []
        gps.append(photo.gps or (math.nan, math.nan))
        turned.append(photo.turned)
    size = (len(columns[0]), len(rows[0]))
    if min(size) < SMALLEST:
        raise CaptureError(
            f"{source}: expected images of at least {SMALLEST} pixels along each side, got {size[0]} × {size[1]}"
        )
    if not source.is_dir():
        size = _without_bars([made / name for name in names], videos.within_bars(np.array(rows), np.array(columns)))
    focal = photo_files.focal_length(source, size) if source.is_dir() else None
    index = {
        "names": names,
        "seconds": seconds,
        "files": files,
        "size": size,
        "focal": focal,
        "gps": gps,
        "turned": turned,
        "remarks": told.remarks,
        "cuts": told.cuts,
    }
    (made / INDEX).write_text(json.dumps(index), "utf-8")


def _without_bars(paths: list[Path], inside: tuple[int, int, int, int]) -> tuple[int, int]:
    """Crop images to what is within black bars, if there are any; return their new size."""
    left, upper, right, lower = inside
    for path in paths if (left, upper) != (0, 0) else ():
        photo_files.read_photo(path).crop(inside).save(path, quality=95, subsampling=0)
    return right - left, lower - upper


def _photos(kept: Path) -> Photos:
    index = json.loads((kept / INDEX).read_text("utf-8"))
    width, height = index["size"]
    K = None
    if index["focal"]:
        K = torch.tensor([[index["focal"], 0, width / 2], [0, index["focal"], height / 2], [0, 0, 1]]).double()
    paths = [kept / name for name in index["names"]]
    gps = torch.tensor(index["gps"], dtype=torch.float64)
    seconds = torch.tensor(index["seconds"], dtype=torch.float64)
    turned = torch.tensor(index["turned"]) if any(index["turned"]) else None
    return Photos(
        paths,
        width,
        height,
        seconds,
        K,
        gps=None if gps.isnan().all() else gps,
        turned=turned,
        remarks=tuple(index["remarks"]),
        files=tuple(index["files"]),
        cuts=tuple(index["cuts"]),
    )
