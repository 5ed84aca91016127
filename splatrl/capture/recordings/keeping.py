"""The images of a recording that are used: chosen, turned upright, and as one camera would have seen them."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.frames import buckets, sharpest, sharpness
from splatrl.capture.lens import Floats, Lens
from splatrl.capture.photo_files import orientation
from splatrl.capture.progress import Progress
from splatrl.capture.recordings.base import Depth, Picture, Recording
from splatrl.capture.recordings.turning import (
    quarter_turns,
    stated_turns,
    turned_camera,
    turned_image,
    turned_poses,
)
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.undistort import seen_by

SHOTS, INDEX, DEPTHS = "shots", "index.json", "depth"
GRADED = 6
"""Number of images per stretch of a recording that are examined to find the sharpest."""
SPREAD = 1.1
"""Maximum ratio of the largest to the smallest focal length of what still counts as one camera."""
WANDER = 0.1
"""Maximum movement of that camera's principal point, as by an image stabiliser, in widths of the image."""
CROPPED = 3.0
"""Maximum ratio of the focal length of what every image shows to that of the images."""


def keep(recording: Recording, folder: Path, count: tuple[int, int], longest: int, progress: Progress) -> Photos:
    """Take the sharpest image of each stretch of a recording, and write them as one camera would have seen them.

    A second call with the same files and settings reads what the first one kept.

    Args:
        recording: a recording whose poses have been checked; depth of images with lens distortion is ignored.
        folder: the capture's folder; images are written to its sub-folder ``shots``, depth to ``shots/depth``.
        count: minimum (where there are so many) and maximum number of images.
        longest: maximum pixels along the longer side.
        progress: called for every image.

    Raises:
        CaptureError: where images are of several cameras, or one cannot be read.
    """

    def write(made: Path) -> None:
        _write(made, recording, count, longest, progress)

    measured = (file for shot in recording.shots for file in shot.depth_files)
    key = fingerprint([count, longest], files=[*recording.files, *measured])
    return _photos(Stages(folder).folder(SHOTS, key, write), recording)


def one_camera(source: object, lenses: Sequence[Lens], border: float = 0.0) -> tuple[Lens, Floats]:
    """Return a camera that sees only what every image shows.

    Images of pinhole cameras in one place differ only by a scale and a shift. So the camera has the median principal
    point of the others, and the shortest focal length with which each image, cropped and scaled, fills its view. Of an
    image with lens distortion, what counts is the largest part that fills a rectangle without it.

    Args:
        source: the recording, for messages.
        lenses: N cameras, at least one.
        border: pixels to cut off along the edges of each image.

    Returns:
        The camera, without distortion; and the crop of each image, without distortion, that is its view: [N, 4] left,
        upper, right and lower edge, pixels.

    Raises:
        CaptureError: for cameras too different to be one.
    """
    own, sizes = _table(lenses), np.array([[lens.width, lens.height] for lens in lenses])
    if (sizes.max(0) > SPREAD * sizes.min(0)).any():
        least, most = sizes[sizes[:, 0].argmin()], sizes[sizes[:, 0].argmax()]
        shown = " and ".join(f"{width:.0f} × {height:.0f}" for width, height in (least, most))
        raise CaptureError(f"{source}: expected images of one size and one camera, got {shown}")
    size = sizes.min(0)
    fx, fy, aside = own[:, 0], own[:, 1], own[:, 2:] - sizes / 2
    wander = np.ptp(aside, axis=0).max() / size[0]
    if max(fx.max() / fx.min(), fy.max() / fy.min()) > SPREAD or wander > WANDER:
        raise CaptureError(
            f"{source}: expected one camera, got focal lengths from {fx.min():.0f} to {fx.max():.0f} pixels, and a "
            f"principal point that moves by {100 * wander:.0f} % of the width; keep only the images of one camera"
        )
    focal, middle = np.median(own[:, :2], axis=0), size / 2 + np.median(aside, axis=0)
    reach = np.minimum(middle, size - middle)
    if (reach < 0.2 * size).any():
        raise CaptureError(
            f"{source}: expected a principal point near the middle of {size[0]:.0f} × {size[1]:.0f} pixels, got "
            f"({middle[0]:.0f}, {middle[1]:.0f}); are the intrinsics for another image size?"
        )
    without = [lens.straight() for lens in lenses]
    straightened = _table(without)
    focals, before = straightened[:, :2], straightened[:, 2:] - border  # extents of the part that shows something
    behind = sizes - border - straightened[:, 2:]
    zoom = (focals / focal * np.maximum(middle / before, (size - middle) / behind)).max()
    folded = any(map(Lens.folds, lenses, without))
    if (focals <= 0).any() or not zoom < CROPPED or folded:
        raise CaptureError(
            f"{source}: expected lens distortion that leaves at least a third of each image without it, got less; are "
            "the coefficients those of OpenCV?"
        )
    camera = Lens(*size.tolist(), *(zoom * focal).tolist(), *middle.tolist())
    scale = focals / (zoom * focal)
    upper_left = straightened[:, 2:] - middle * scale
    boxes = np.concatenate([upper_left, upper_left + size * scale], 1)
    return camera, np.clip(boxes, 0.0, np.tile(sizes, 2))


def _table(lenses: Sequence[Lens]) -> Floats:
    """Return fx, fy, cx and cy of each lens: [N, 4]."""
    return np.array([[lens.fx, lens.fy, lens.cx, lens.cy] for lens in lenses])


def _write(made: Path, recording: Recording, count: tuple[int, int], longest: int, progress: Progress) -> None:
    shots = recording.shots
    camera, boxes = one_camera(recording.source, [shot.lens for shot in shots], recording.border)
    poses = np.array([shot.camera_to_world for shot in shots])
    turns = _turns(recording, poses)
    depths = _DepthFiles(made / DEPTHS, recording.source)
    index: dict[str, Any] = {"names": [], "seconds": [], "files": [], "poses": [], "remarks": [*recording.remarks]}
    size: tuple[int, int] | None = None
    for number, picture in _chosen(recording, count, progress, index["remarks"].append):
        image, shot, name = picture.image(), shots[number], f"{len(index['names']):04}"
        stored = _scale(f"{recording.source}: {shot.name}", image, shot.lens)
        size = size or _size(camera, min(*stored, longest / max(camera.width, camera.height)))
        distorted = shot.lens.bends
        box = boxes[number] * np.tile(stored, 2)
        seen = seen_by(camera, image, shot.lens, size) if distorted else _cut(image, box, size)
        turned_image(seen, turns).save(made / f"{name}.jpg", quality=95, subsampling=0)
        depth = None if shot.depth is None or distorted else _cut_depth(shot.depth(), boxes[number], shot.lens, turns)
        depths.write(name, depth)
        index["names"].append(name)
        index["seconds"].append(shot.seconds - shots[0].seconds)
        index["files"] += [] if recording.timed else [shot.name]
        index["poses"].append(turned_poses(poses[number], turns).tolist())
    if size is None:
        raise CaptureError(f"{recording.source}: expected images for its poses, found none")
    index["size"], K = turned_camera(size, camera.K(size), turns)
    index["K"] = K.tolist()
    index["depth"] = depths.finish()
    (made / INDEX).write_text(json.dumps(index), "utf-8")


def _turns(recording: Recording, poses: Floats) -> int:
    """Return how many quarters to turn the images counter-clockwise: by gravity, or else as their EXIF says."""
    if recording.up is not None:
        return quarter_turns(poses, recording.up)
    files = [shot.path for shot in recording.shots if shot.path is not None]
    return stated_turns(poses, map(orientation, files)) if files else 0


def _scale(name: str, image: Image.Image, lens: Lens) -> Floats:
    """Return how much larger an image is than its intrinsics say, across and down: it may have been rescaled since."""
    stored = np.array(image.size) / [lens.width, lens.height]
    if abs(stored[0] / stored[1] - 1) > 0.01:
        shape = f"{lens.width:.0f} × {lens.height:.0f}"
        raise CaptureError(
            f"{name}: expected an image with the aspect ratio of {shape}, got {image.width} × {image.height}"
        )
    return stored


def _size(camera: Lens, scale: float) -> tuple[int, int]:
    return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


def _chosen(
    recording: Recording, count: tuple[int, int], progress: Progress, remark: Callable[[str], object]
) -> Iterator[tuple[int, Picture]]:
    """Yield the sharpest image of each stretch; all images where there are few, or where they were chosen already."""
    seconds = np.array([shot.seconds for shot in recording.shots])
    if recording.prepared or len(seconds) <= count[0]:
        numbers, stretches = np.arange(len(seconds)), np.arange(len(seconds))
    else:
        ends = buckets(seconds, count)
        numbers = np.arange(0, len(seconds), max(1, len(seconds) // (GRADED * (len(ends) + 1))))
        stretches = np.searchsorted(ends, seconds, side="right")

    read: set[int] = set()

    def graded() -> Iterator[tuple[int, tuple[int, Picture], float]]:
        for number, picture in recording.pictures(numbers.tolist()):
            progress("frames", number, len(seconds))
            read.add(number)
            single = np.count_nonzero(stretches[numbers] == stretches[number]) == 1
            yield int(stretches[number]), (number, picture), 0.0 if single else sharpness(picture.grey())

    yield from sharpest(graded())
    progress("frames", len(seconds), len(seconds))
    if unread := len(numbers) - len(read):
        remark(f"{unread} of {len(numbers)} images are damaged, and are not used.")


def _cut(image: Image.Image, box: Floats, size: tuple[int, int]) -> Image.Image:
    """Crop an image to what the one camera sees, and resize it."""
    box = np.clip(box, 0.0, np.tile(image.size, 2))
    return image.resize(size, Image.Resampling.BICUBIC, tuple(box.tolist()))


def _cut_depth(depth: Depth, box: Floats, lens: Lens, turns: int) -> Depth:
    """Crop measured depth to what the one camera sees, at the sensor's size, and turn it; never interpolate depths."""
    left, upper, right, lower = box / [lens.width, lens.height, lens.width, lens.height]
    places = []
    for start, end, size in ((upper, lower, depth.shape[0]), (left, right, depth.shape[1])):
        middles = start + (np.arange(size) + 0.5) / size * (end - start)
        places.append(np.minimum((middles * size).astype(int), size - 1))
    return np.rot90(depth[np.ix_(*places)], turns)


class _DepthFiles:
    """Writes depth images: blank ones for shots without depth, and no folder where no shot has any."""

    def __init__(self, folder: Path, source: object) -> None:
        self.folder, self.source = folder, source
        self.size: tuple[int, ...] | None = None
        self.missing: list[str] = []

    def write(self, name: str, depth: Depth | None) -> None:
        if depth is None:
            self.missing.append(name)
            return
        if self.size is None:
            self.size = depth.shape
            self.folder.mkdir()
        if depth.shape != self.size:
            raise CaptureError(f"{self.source}: expected depth images of one size, got {self.size} and {depth.shape}")
        Image.fromarray(np.ascontiguousarray(depth)).save(self.folder / f"{name}.png")

    def finish(self) -> bool:
        """Write the blank depth images; return whether there is any depth."""
        if self.size is None:
            return False
        for name in self.missing:
            Image.fromarray(np.zeros(self.size, np.uint16)).save(self.folder / f"{name}.png")
        return True


def _photos(kept: Path, recording: Recording) -> Photos:
    index = json.loads((kept / INDEX).read_text("utf-8"))
    names = index["names"]
    width, height = index["size"]
    return Photos(
        [kept / f"{name}.jpg" for name in names],
        width,
        height,
        torch.tensor(index["seconds"], dtype=torch.float64),
        torch.tensor(index["K"], dtype=torch.float64),
        torch.tensor(index["poses"], dtype=torch.float64),
        None if recording.up is None else torch.from_numpy(recording.up),
        tuple(kept / DEPTHS / f"{name}.png" for name in names) if index["depth"] else (),
        recording.metric,
        remarks=tuple(index["remarks"]),
        files=tuple(index["files"]),
    )
