"""Recordings of Stray Scanner: a video, a row of odometry for each frame, and what the depth sensor measured.

Documented in https://github.com/strayrobots/scanner (docs/format.md): metres, quaternions x, y, z, w; depth in
millimetres, confidence 0, 1 or 2. The world is ARKit's (+y up); the app has already converted the camera's axes to
OpenCV's, and the intrinsics are those of the frames as they are stored, whichever way up a player shows them.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from splatrl import images
from splatrl.capture import videos
from splatrl.capture.base import CaptureError
from splatrl.capture.frames import SHARPNESS_WIDTH
from splatrl.capture.lens import Floats, Lens
from splatrl.capture.recordings.base import (
    ARKIT_UP,
    Picture,
    Recording,
    Shot,
    depth_files,
    quaternion_poses,
    read_depth,
    read_text,
)

if TYPE_CHECKING:
    from av import VideoFrame

VIDEO, ODOMETRY, CAMERA = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
MEDIUM = 1
"""Minimum confidence of the depths that are kept."""
NEEDED = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
INTRINSICS = ("fx", "fy", "cx", "cy")
"""Columns with each frame's intrinsics; older versions of the app write them to ``camera_matrix.csv`` alone."""


def found(source: Path) -> bool:
    """Return whether a folder is such a recording."""
    return (source / ODOMETRY).is_file() and (source / VIDEO).is_file()


def read(source: Path) -> Recording:
    """Read a recording; rows beyond the end of its video, and a last row that was cut off, are left out.

    Raises:
        CaptureError: where it is broken.
    """
    path, video = source / ODOMETRY, source / VIDEO
    columns, remarks = _columns(path)
    numbers = columns["frame"]
    if not (np.diff(numbers) > 0).all() or (numbers % 1 != 0).any() or numbers[0] < 0:
        raise CaptureError(f"{path}: frame: expected ascending, non-negative whole numbers")
    times = videos.packet_times(video)
    shown = numbers < len(times)
    if not shown.all():
        remarks.append(
            f"{ODOMETRY} has rows up to frame {numbers[-1]:.0f}, but {VIDEO} has only {len(times)} frames: "
            f"{np.count_nonzero(~shown)} of {len(numbers)} rows are not used."
        )
        columns, numbers = {name: values[shown] for name, values in columns.items()}, numbers[shown]
    names = [f"{ODOMETRY}: frame {number:.0f}" for number in numbers]
    poses = quaternion_poses(
        source,
        names,
        np.stack([columns[name] for name in ("qx", "qy", "qz", "qw")], 1),
        np.stack([columns[name] for name in ("x", "y", "z")], 1),
    )
    width, height = videos.size(video)
    shared = [source / CAMERA] if (source / CAMERA).is_file() else []
    usual = _camera(shared[0]) if shared else (np.nan,) * 4
    own = np.stack([columns[name] for name in INTRINSICS], 1)
    lenses = [Lens(width, height, *np.where(np.isfinite(row), row, usual).tolist()) for row in own]
    shots = []
    for name, seconds, number, lens, pose in zip(
        names, columns["timestamp"], numbers.astype(int), lenses, poses, strict=True
    ):
        measured = depth_files(*(source / folder / f"{number:06}.png" for folder in ("depth", "confidence")))
        depth = partial(read_depth, *measured, least=MEDIUM) if measured else None
        shots.append(Shot(name, float(seconds), lens, pose, depth=depth, depth_files=measured))
    return Recording(
        source,
        shots,
        partial(_pictures, video, times[numbers.astype(int)]),
        [path, video, *shared],
        up=ARKIT_UP,
        metric=True,
        remarks=tuple(remarks),
    )


class FramePicture:
    """A frame of a video as it is stored.

    Args:
        frame: the decoded frame.
    """

    def __init__(self, frame: "VideoFrame") -> None:
        self.frame = frame

    def grey(self) -> NDArray[np.uint8]:
        """Return its brightness, scaled down: [H, W]."""
        return videos.grey(self.frame, SHARPNESS_WIDTH)

    def image(self) -> Image.Image:
        """Return the whole frame, RGB."""
        return images.in_colour(self.frame)


def _pictures(video: Path, times: Floats, wanted: Sequence[int]) -> Iterator[tuple[int, Picture]]:
    """Yield the wanted frames, given the times of all; a frame that cannot be decoded is left out."""
    rows = np.array(wanted)
    for seconds, frame in videos.frames(video):
        near = np.flatnonzero(np.isclose(times[rows], seconds, rtol=0, atol=1e-6))
        if len(near):
            yield int(rows[near[0]]), FramePicture(frame)


def _columns(path: Path) -> tuple[dict[str, Floats], list[str]]:
    """Return the columns of a table by name, and remarks on rows that were left out.

    Missing values, and missing columns that are not ``NEEDED``, are NaN. A last row that is shorter than the one before
    is left out: the app was stopped while it wrote.
    """
    rows = [row for row in csv.reader(io.StringIO(read_text(path)), skipinitialspace=True) if row]
    names = [name.strip() for name in rows[0]] if rows else []
    remarks = []
    if len(rows) > 2 and len(rows[-1]) < len(rows[-2]):
        remarks.append(f"The last row of {ODOMETRY} is cut off, and is not used.")
        rows.pop()
    missing = [name for name in NEEDED if name not in names]
    if missing or len(rows) < 2:
        raise CaptureError(f"{path}: expected one row per frame, with the columns {', '.join(NEEDED)}")
    values = {name: np.full(len(rows) - 1, np.nan) for name in (*NEEDED, *INTRINSICS)}
    for name in values:
        for number, row in enumerate(rows[1:] if name in names else []):
            try:
                values[name][number] = _number(row[names.index(name)])
            except (ValueError, IndexError):
                raise CaptureError(_expected(path, number, row, name)) from None
            if name in NEEDED and not np.isfinite(values[name][number]):
                raise CaptureError(_expected(path, number, row, name))
    return values, remarks


def _expected(path: Path, number: int, row: list[str], name: str) -> str:
    return f"{path}: row {number + 2}: {name}: expected a finite number, got {', '.join(row)[:80]!r}"


def _number(text: str) -> float:
    return float(text) if text.strip() else np.nan


def _camera(path: Path) -> tuple[float, ...]:
    try:
        matrix = np.array([[float(value) for value in row.split(",")] for row in read_text(path).split("\n") if row])
        if matrix.shape != (3, 3):
            raise ValueError(f"got the shape {matrix.shape}")
    except ValueError as error:
        raise CaptureError(f"{path}: expected 3 rows of 3 numbers: {error}") from error
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
