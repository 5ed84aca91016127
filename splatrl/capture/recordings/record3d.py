"""Recordings of Record3D: an ``.r3d`` file, which is a ZIP archive, or its unpacked folder.

As its author describes it (https://github.com/marek-simonik/record3d, issues 7, 33, 64, 81 and 93): ``metadata`` is
JSON; poses are qx, qy, qz, qw, x, y, z, metres, camera-to-world with OpenGL's axes of the image as it is stored; K is
stored column by column; ``rgbd`` holds an image, depth (float32 metres, NaN where there is none, compressed with LZFSE)
and confidence (bytes, 0, 1 or 2, compressed with LZFSE) for each frame. The world is ARKit's (+y up), except in early
versions of the app, where it has the first camera's own axes. Folders of the EXR export (``rgb`` and ``depth``) are
read without their depth.
"""

import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.base import CaptureError
from splatrl.capture.lens import Lens
from splatrl.capture.recordings.base import (
    ARKIT_UP,
    MAX_BYTES,
    OPENGL,
    Depth,
    FilePicture,
    Picture,
    Recording,
    Shot,
    filtered,
    quaternion_poses,
    read_json,
)
from splatrl.extras import require
from splatrl.files import read_entry

METADATA = ("metadata", "metadata.json")
IMAGE = re.compile(r"(rgbd|rgb)/([0-9]{1,9})\.jpg")
MEDIUM = 1
"""Minimum confidence of the depths that are kept."""
MAX_DEPTH = 2**22
"""Maximum pixels of a depth image, since a few bytes may unpack to any number; phones' sensors have a tenth of it."""
USUAL_DEPTH = (256, 192)
"""Height and width of the depth images, which early versions of the app do not state."""
DAMAGED = (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, KeyError, OSError, ValueError)
"""Exceptions that reading from a folder or a damaged archive raises."""


def found(source: Path) -> bool:
    """Return whether a path leads to such a recording."""
    if source.is_file():
        return source.suffix.lower() == ".r3d"
    pictures = any((source / name).is_dir() for name in ("rgbd", "rgb"))
    return pictures and any((source / name).is_file() for name in METADATA)


def read(source: Path) -> Recording:
    """Read a recording.

    Only reading the depth of a shot needs the extra ``capture``.

    Raises:
        CaptureError: where it is broken.
    """
    files = Files(source)
    name = next((name for name in METADATA if name in files.names), METADATA[0])
    where = f"{source}: {name}"
    metadata = read_json(where, files.read(name))
    images = {int(match[2]): match[0] for match in map(IMAGE.fullmatch, sorted(files.names)) if match}
    try:
        poses, up = _poses(where, metadata)
        lenses = _lenses(metadata, len(poses))
        size = int(metadata.get("dh", USUAL_DEPTH[0])), int(metadata.get("dw", USUAL_DEPTH[1]))
        times = metadata.get("frameTimestamps") or [n / float(metadata.get("fps", 60)) for n in range(len(poses))]
        seconds = [float(time) for time in times]
        numbers = [n for n in range(min(len(poses), len(seconds))) if n in images]
        if min(size) < 1 or size[0] * size[1] > MAX_DEPTH:
            raise ValueError(f"dh, dw: expected the height and width of a depth image, got {size}")
        shots = [
            Shot(f"{name}: poses[{n}]", seconds[n], lenses[n], poses[n] @ OPENGL, depth=_depth_of(files, n, size))
            for n in numbers
        ]
    except CaptureError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, ZeroDivisionError) as error:
        raise CaptureError(f"{where}: expected the metadata of a Record3D recording: {error!r}") from error
    pictures = partial(_pictures, files, [images[n] for n in numbers])
    left = len(poses) - len(numbers)
    remarks = (f"{left} of {len(poses)} poses have no image or no time, and are not used.",) if left else ()
    return Recording(source, shots, pictures, files.stamped, up=up, metric=True, remarks=remarks)


class Files:
    """The files of a recording in a folder or a ZIP archive; names in an archive are never used as paths.

    Args:
        source: the folder, or the archive.

    Attributes:
        names: names of the files.
        stamped: files whose change makes it another recording.
    """

    def __init__(self, source: Path) -> None:
        self.source = source
        self._archive: zipfile.ZipFile | None = None
        self.stamped = [source]
        if source.is_dir():
            folders = [source, *(source / name for name in ("rgbd", "rgb") if (source / name).is_dir())]
            paths = [path for folder in folders for path in folder.iterdir() if path.is_file()]
            paths = [path for path in paths if not path.name.startswith(".")]  # such as .DS_Store
            self.names = {path.relative_to(source).as_posix() for path in paths}
            self.stamped = sorted(paths)
            return
        try:
            self._archive = zipfile.ZipFile(source)
        except DAMAGED as error:
            raise CaptureError(
                f"{source}: expected a ZIP archive of Record3D, got another file or a damaged one"
            ) from error
        self.names = set(self._archive.namelist())

    def open(self, name: str) -> io.BytesIO:
        """Return the content of a file as a stream; raises as ``read`` does."""
        return io.BytesIO(self.read(name))

    def read(self, name: str) -> bytes:
        """Read a file.

        Raises:
            CaptureError: for one that is missing, damaged or too large.
        """
        try:
            if self._archive is not None:
                return read_entry(self._archive, self._archive.getinfo(name), MAX_BYTES)
            path = self.source / name
            if path.stat().st_size > MAX_BYTES:
                raise ValueError(f"expected at most {MAX_BYTES:,} bytes, got {path.stat().st_size:,}")
            return path.read_bytes()
        except DAMAGED as error:
            raise CaptureError(f"{self.source}: {name}: could not be read: {error}") from error


def _pictures(files: Files, names: list[str], wanted: Sequence[int]) -> Iterator[tuple[int, Picture]]:
    for number in wanted:
        name = names[number]
        yield number, FilePicture(files.source / name, partial(files.open, name))


def _poses(where: str, metadata: Any) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return poses [N, 4, 4] with OpenGL's camera axes, and the upward direction in their frame, None where unknown."""
    given = np.array(metadata["poses"], np.float64).reshape(-1, 7)
    poses = quaternion_poses(where, [f"poses[{n}]" for n in range(len(given))], given[:, :4], given[:, 4:])
    if len(poses) and _unturned(poses[0]):
        first = np.array(metadata.get("initPose", [0, 0, 0, 1, 0, 0, 0]), np.float64).reshape(1, 7)
        start = quaternion_poses(where, ["initPose"], first[:, :4], first[:, 4:])[0]
        if _unturned(start):
            return poses, None
        poses = start @ poses
    return poses, ARKIT_UP


def _unturned(pose: NDArray[np.float64]) -> bool:
    """Return whether a camera has the world's axes, to a tenth of a degree: no phone is held like that by chance."""
    return bool(np.abs(pose[:3, :3] - np.eye(3)).max() < 2e-3)


def _lenses(metadata: Any, count: int) -> list[Lens]:
    width, height = float(metadata["w"]), float(metadata["h"])
    own = metadata.get("perFrameIntrinsicCoeffs") or []
    if len(own) == count:
        return [Lens(width, height, *_four(row)) for row in own]
    K = [float(value) for value in metadata["K"]]
    return [Lens(width, height, K[0], K[4], K[6], K[7])] * count


def _four(row: Any) -> tuple[float, float, float, float]:
    fx, fy, cx, cy = (float(value) for value in row)
    return fx, fy, cx, cy


def _depth_of(files: Files, number: int, size: tuple[int, int]) -> Callable[[], Depth] | None:
    name, trust = f"rgbd/{number}.depth", f"rgbd/{number}.conf"
    if name not in files.names:
        return None
    return partial(read_depth_of, files, name, trust if trust in files.names else None, size)


def read_depth_of(files: Files, name: str, trust: str | None, size: tuple[int, int]) -> Depth:
    """Read the depth of one image.

    Args:
        files: files of the recording.
        name: name of the depth file.
        trust: name of the confidence file; None trusts everything.
        size: height and width of both.

    Raises:
        CaptureError: for a file that is damaged, or of another size once unpacked.
        ImportError: without the extra ``capture``.
    """
    metres = np.frombuffer(_unpacked(files, name, 4 * size[0] * size[1]), "<f4").reshape(size)
    confidence = None
    if trust is not None:
        confidence = np.frombuffer(_unpacked(files, trust, size[0] * size[1]), np.uint8).reshape(size)
    with np.errstate(invalid="ignore"):
        millimetres = np.where((metres > 0) & (metres < 65), 1000 * metres + 0.5, 0).astype(np.uint16)
    return filtered(f"{files.source}: {name}", millimetres, confidence, MEDIUM)


def _unpacked(files: Files, name: str, size: int) -> bytes:
    """Unpack a file compressed with LZFSE, but never more than one byte beyond the expected size."""
    codecs = require("imagecodecs", "capture")
    try:
        unpacked: bytes = codecs.lzfse_decode(files.read(name), out=size + 1)
    except codecs.LzfseError as error:
        raise CaptureError(f"{files.source}: {name}: expected LZFSE, got a damaged file: {error}") from error
    if len(unpacked) != size:
        many = "more" if len(unpacked) > size else f"{len(unpacked):,}"
        raise CaptureError(f"{files.source}: {name}: expected {size:,} unpacked bytes, got {many}")
    return unpacked
