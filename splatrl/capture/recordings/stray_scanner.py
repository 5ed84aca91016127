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

from splatrl.capture import videos
from splatrl.capture.base import CaptureError
from splatrl.capture.frames import SHARPNESS_WIDTH
from splatrl.capture.recordings.base import (
    ARKIT_UP,
    Floats,
    Lens,
    Picture,
    Recording,
    Shot,
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
    """Read a recording.

    Raises:
        CaptureError: where it is broken.
    """
    path, video = source / ODOMETRY, source / VIDEO
    columns = _columns(path)
    numbers = columns["frame"]
    if not (np.diff(numbers) > 0).all() or (numbers % 1 != 0).any() or numbers[0] < 0:
        raise CaptureError(f"{path}: frame: expected ascending, non-negative whole numbers")
    poses = quaternion_poses(
        path,
        np.stack([columns[name] for name in ("qx", "qy", "qz", "qw")], 1),
        np.stack([columns[name] for name in ("x", "y", "z")], 1),
    )
    width, height = videos.size(video)
    usual = _camera(source / CAMERA) if (source / CAMERA).is_file() else (np.nan,) * 4
    own = np.stack([columns[name] for name in INTRINSICS], 1)
    lenses = [Lens(width, height, *np.where(np.isfinite(row), row, usual).tolist()) for row in own]
    shots = []
    for seconds, number, lens, pose in zip(columns["timestamp"], numbers.astype(int), lenses, poses, strict=True):
        depth, trust = (source / name / f"{number:06}.png" for name in ("depth", "confidence"))
        trusted = trust if trust.is_file() else None
        measured = partial(read_depth, depth, trusted, MEDIUM) if depth.is_file() else None
        shots.append(Shot(float(seconds), lens, pose, depth=measured))
    return Recording(
        source, shots, partial(_pictures, video, numbers.astype(int)), [path, video], up=ARKIT_UP, metric=True
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
        return self.frame.to_image()


def _pictures(video: Path, numbers: NDArray[np.int64], wanted: Sequence[int]) -> Iterator[tuple[int, Picture]]:
    rows = {int(numbers[row]): row for row in wanted}
    for number, (_, frame) in enumerate(videos.frames(video)):
        if number in rows:
            yield rows[number], FramePicture(frame)


def _columns(path: Path) -> dict[str, Floats]:
    """Return the columns of a table by name; missing values, and missing columns that are not ``NEEDED``, are NaN."""
    rows = [row for row in csv.reader(io.StringIO(read_text(path)), skipinitialspace=True) if row]
    names = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in NEEDED if name not in names]
    if missing or len(rows) < 2:
        raise CaptureError(f"{path}: expected one row per frame, with the columns {', '.join(NEEDED)}")
    try:
        values = {
            name: np.array([_number(row[names.index(name)]) for row in rows[1:]])
            for name in (*NEEDED, *INTRINSICS)
            if name in names
        }
    except (ValueError, IndexError) as error:
        raise CaptureError(f"{path}: expected a number in every column: {error}") from error
    if not all(np.isfinite(values[name]).all() for name in NEEDED):
        raise CaptureError(f"{path}: expected finite numbers in {', '.join(NEEDED)}")
    return {name: np.full(len(rows) - 1, np.nan) for name in INTRINSICS} | values


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
