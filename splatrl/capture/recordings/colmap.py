"""A COLMAP model beside its images, in COLMAP's documented file format (https://colmap.github.io/format.html).

The files are parsed here rather than by COLMAP, which allocates as much memory as a file claims to need.
"""

import itertools
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from splatrl.capture.base import CaptureError
from splatrl.capture.lens import Lens
from splatrl.capture.recordings.base import (
    Recording,
    Shot,
    beside,
    pictures_of,
    quaternion_poses,
    without_pose,
)
from splatrl.files import natural

Kept = TypeVar("Kept")
MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""Camera models, by the number that stands for each in ``cameras.bin``."""
DISTORTION: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "p1", "p2"),
}
"""Perspective camera models, each with the distortion coefficients that come last among its parameters."""
POINTS = re.compile(r"[-+.\deE\s]*")
"""What a line of ``images.txt`` with points consists of, three numbers each; tools may leave such lines out."""
MOST = 100_000
"""Maximum number of cameras and of images in a model."""
LONGEST = 2**13
"""Number of bytes from which a line of a text holds points, and maximum length of a name."""


def found(source: Path) -> bool:
    """Return whether a folder holds a model, itself, in ``sparse``, or in a sub-folder of that or ``colmap/sparse``."""
    return bool(_models(source))


def read(source: Path) -> Recording:
    """Read a model whose images are in ``images`` or beside it; of several, the one with the most images.

    Raises:
        CaptureError: where it is broken, lacks images, or has a camera that is not perspective.
    """
    models = _models(source)
    counts = [_claimed(model) for model in models] if len(models) > 1 else [1]
    model = models[counts.index(max(counts))]
    kind = "bin" if (model / "cameras.bin").is_file() else "txt"
    read_cameras, read_images = (_cameras, _images) if kind == "bin" else (_cameras_text, _images_text)
    files = [model / f"{name}.{kind}" for name in ("cameras", "images")]
    lenses = _read(files[0], read_cameras)
    images = sorted(_read(files[1], read_images), key=lambda image: natural(Path(image.name)))
    if not images:
        raise CaptureError(f"{files[1]}: expected at least one image, got none")
    names = [image.name for image in images]
    if twice := next((name for name, after in itertools.pairwise(names) if name == after), None):
        raise CaptureError(f"{files[1]}: expected each image once, got {twice[:80]!r} twice")
    places = [place for place in (source / "images", model / "images", source) if place.is_dir()]
    paths = [_beside_any(model, places, image.name) for image in images]
    if missing := {image.camera for image in images} - lenses.keys():
        raise CaptureError(f"{files[1]}: expected camera ids that are in {files[0].name}, got {min(missing)}")
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    given = np.array([image.pose for image in images])
    world_to_camera = quaternion_poses(files[1], names, given[:, [1, 2, 3, 0]], given[:, 4:])
    poses[:, :3, :3] = world_to_camera[:, :3, :3].transpose(0, 2, 1)
    poses[:, :3, 3] = np.einsum("nij,nj->ni", poses[:, :3, :3], -given[:, 4:])
    shots = [
        Shot(image.name, float(n), lenses[image.camera], pose, path)
        for n, (image, pose, path) in enumerate(zip(images, poses, paths, strict=True))
    ]
    remarks = without_pose(paths)
    others = [f"{_shown(each)} ({count})" for each, count in zip(models, counts, strict=True) if each != model]
    if others:
        used = f"{_shown(model)}, with the most images ({len(images)}), is used, and not {', '.join(others)}"
        remarks = (f"COLMAP joined the images into {len(models)} models: {used}.", *remarks)
    return Recording(model, shots, pictures_of(paths), [*files, *paths], prepared=True, remarks=remarks)


class _Image(NamedTuple):
    """An image of a model: world-to-camera pose (quaternion w, x, y, z and translation), id of its camera, name."""

    pose: tuple[float, ...]
    camera: int
    name: str


def _read(path: Path, read: Callable[[mmap], Kept]) -> Kept:
    """Parse a file of any size, most of which are points: what is skipped is not read."""
    try:
        if path.stat().st_size == 0:
            raise ValueError("it is empty")
        with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as content:
            return read(content)
    except CaptureError as error:
        raise CaptureError(f"{path}: {error}") from error
    except (OSError, ValueError, IndexError, OverflowError, struct.error) as error:
        raise CaptureError(f"{path}: expected a COLMAP model: {error}") from error


def _count(content: mmap) -> int:
    """Return the number with which a binary file begins."""
    (count,) = struct.unpack_from("<Q", content)
    if count > MOST:
        raise ValueError(f"at most {MOST:,} entries, got {count:,}")
    return int(count)


def _cameras(content: mmap) -> dict[int, Lens]:
    """Parse ``cameras.bin``: id, model, width, height, parameters."""
    at, lenses = 8, {}
    for _ in range(_count(content)):
        number, model, width, height = struct.unpack_from("<IiQQ", content, at)
        name = MODELS[model] if 0 <= model < len(MODELS) else str(model)
        size = _parameters(name)
        lenses[number] = _lens(name, width, height, struct.unpack_from(f"<{size}d", content, at + 24))
        at += 24 + 8 * size
    return lenses


def _images(content: mmap) -> list[_Image]:
    """Parse ``images.bin``: id, pose, camera id, zero-terminated name, and points, which are skipped."""
    at, images = 8, list[_Image]()
    for _ in range(_count(content)):
        *pose, camera = struct.unpack_from("<7dI", content, at + 4)
        end = content.find(b"\0", at + 64, at + 64 + LONGEST)
        if end < 0:
            raise ValueError(f"the name of image {len(images) + 1} does not end")
        images.append(_Image(tuple(pose), camera, content[at + 64 : end].decode()))
        (points,) = struct.unpack_from("<Q", content, end + 1)
        at = end + 9 + 24 * points
        if at > len(content):
            raise ValueError("it ends too early")
    return images


def _cameras_text(content: mmap) -> dict[int, Lens]:
    lenses = {}
    for line in _lines(content):
        number, name, width, height, *values = line.split()
        lenses[int(number)] = _lens(name, float(width), float(height), tuple(map(float, values)))
    return lenses


def _images_text(content: mmap) -> list[_Image]:
    images = []
    for line in _lines(content):
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise ValueError(f"{line[:80]!r}: expected an id, a pose of 7 numbers, a camera's id and a name")
        _, *numbers, camera, name = words
        images.append(_Image(tuple(map(float, numbers)), int(camera), name.rstrip()))
    return images


def _lines(content: mmap) -> Iterator[str]:
    """Yield the lines of a text that are neither blank nor comments nor points; very long ones are points."""
    at, count = 0, 0
    while at < len(content):
        end = content.find(b"\n", at)
        end = len(content) if end < 0 else end
        line = content[at:end].decode().rstrip("\r") if end - at < LONGEST else ""
        at = end + 1
        if not line.strip() or line.startswith("#") or (POINTS.fullmatch(line) and len(line.split()) % 3 == 0):
            continue
        count += 1
        if count > MOST:
            raise ValueError(f"at most {MOST:,} entries")
        yield line


def _models(source: Path) -> list[Path]:
    """Return the folders with a model: those of the first place that has any."""
    for folders in ([source], [source / "sparse"], *map(_within, (source / "sparse", source / "colmap" / "sparse"))):
        found = [each for each in folders if any((each / name).is_file() for name in ("cameras.bin", "cameras.txt"))]
        if found:
            return found
    return []


def _within(folder: Path) -> list[Path]:
    return sorted((each for each in folder.iterdir() if each.is_dir()), key=natural) if folder.is_dir() else []


def _claimed(model: Path) -> int:
    """Return how many images a model claims to have; 0 where that cannot be read."""
    with suppress(CaptureError, OSError, struct.error):
        if (model / "cameras.bin").is_file():
            with (model / "images.bin").open("rb") as stream:
                (count,) = struct.unpack("<Q", stream.read(8))
            return int(count)
        return _read(model / "images.txt", lambda content: sum(1 for _ in _lines(content)))
    return 0


def _shown(model: Path) -> str:
    return f"{model.parent.name}/{model.name}"


def _parameters(name: str) -> int:
    """Return how many parameters a camera model has."""
    if name not in DISTORTION:
        raise CaptureError(f"expected a camera model among {', '.join(DISTORTION)}, got {name[:40]}")
    return len(DISTORTION[name]) + (3 if name.startswith("SIMPLE") or name == "RADIAL" else 4)


def _lens(name: str, width: float, height: float, values: tuple[float, ...]) -> Lens:
    if len(values) != _parameters(name):
        raise ValueError(f"{name}: expected {_parameters(name)} parameters, got {len(values)}")
    shared = _parameters(name) - len(DISTORTION[name]) == 3  # one focal length for both directions
    fx, fy, cx, cy, *own = values[:1] + values if shared else values
    given = dict(zip(DISTORTION[name], own, strict=True))
    distortion = tuple(given.get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3"))
    return Lens(float(width), float(height), fx, fy, cx, cy, distortion)


def _beside_any(model: Path, places: list[Path], name: str) -> Path:
    for place in places:
        if (place / name).is_file():
            return beside(place, name)
    raise CaptureError(f"{model}: {name[:80]!r}: expected this image in {' or '.join(map(str, places))}, found none")
