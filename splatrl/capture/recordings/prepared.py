"""The images of a recording that were chosen and prepared already, which stay as they are where possible."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import torch

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.lens import Lens
from splatrl.capture.photo_files import orientation, photo_size, read_photo
from splatrl.capture.progress import Progress
from splatrl.capture.recordings.base import Recording
from splatrl.capture.recordings.turning import stated_turns, turned_camera, turned_image, turned_poses
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.undistort import undistorted

RECORDED, UPRIGHT = "recorded", "upright"


def as_prepared(recording: Recording, folder: Path, progress: Progress) -> Photos:
    """Return a recording's images where they lie, or copies of them.

    Their poses and intrinsics hold for the images as they are stored, whatever orientation their EXIF states. Where any
    states one, where the images lie in several folders, or where a name is not ``_plain``, they are copied, and turned
    as ``stated_turns`` says. Images with lens distortion are written without it.

    Args:
        recording: a recording of one camera whose poses have been checked; its depth is ignored.
        folder: the capture's folder; images are written to its sub-folder ``recorded``, and those without distortion
            that must be turned to ``upright``.
        progress: called for every image that is written.

    Raises:
        CaptureError: for an image that cannot be read, or whose size or aspect ratio is not the camera's.
    """
    lens, paths = recording.shots[0].lens, [shot.path for shot in recording.shots if shot.path is not None]
    size = _one_size(paths)
    across, down = size[0] / lens.width, size[1] / lens.height  # images may have been rescaled since
    if abs(across / down - 1) > 0.01:
        raise CaptureError(
            f"{recording.source}: expected images with the aspect ratio of {lens.width:.0f} × {lens.height:.0f}, got "
            f"{size[0]} × {size[1]}"
        )
    fx, fy, cx, cy = lens.fx * across, lens.fy * down, lens.cx * across, lens.cy * down
    lens = Lens(*size, fx, fy, cx, cy, lens.distortion)
    told, stages = [orientation(path) for path in paths], Stages(folder)
    poses = np.array([shot.camera_to_world for shot in recording.shots])
    turns = stated_turns(poses, told)
    if lens.bends:
        paths, lens = undistorted(paths, lens, stages, RECORDED, progress)
        if turns:
            paths = _copied(paths, turns, stages, UPRIGHT, progress)
    elif len({path.parent for path in paths}) > 1 or set(told) != {1} or not all(map(_plain, paths)):
        paths = _copied(paths, turns, stages, RECORDED, progress)
    (width, height), turned_K = turned_camera(size, lens.K(size), turns)
    return Photos(
        paths,
        width,
        height,
        torch.arange(len(paths), dtype=torch.float64),
        torch.from_numpy(turned_K),
        torch.from_numpy(turned_poses(poses, turns)),
        None if recording.up is None else torch.from_numpy(recording.up),
        metric=recording.metric,
        remarks=recording.remarks,
        files=() if recording.timed else tuple(shot.name for shot in recording.shots),
    )


def _one_size(paths: list[Path]) -> tuple[int, int]:
    """Return the width and height of all images, as they are stored."""
    sizes = [photo_size(path, upright=False) for path in paths]
    usual = Counter(sizes).most_common(1)[0][0]
    for path, size in zip(paths, sizes, strict=True):
        if size != usual:
            raise CaptureError(
                f"{path}: expected {usual[0]} × {usual[1]} pixels, as most images have, got {size[0]} × {size[1]}"
            )
    return usual


def _plain(path: Path) -> bool:
    """Return whether COLMAP reads a file's name as one in a list of images: without blanks and not as a comment."""
    return path.name.split() == [path.name] and not path.name.startswith("#")


def _copied(paths: list[Path], turns: int, stages: Stages, name: str, progress: Progress) -> list[Path]:
    """Return copies in one folder, in the same order, of images as they are stored, turned by some quarters."""
    unchanged = [turns == 0 and orientation(path) == 1 for path in paths]
    names = [
        f"{number:04}{path.suffix.lower() if same else '.jpg'}"
        for number, (path, same) in enumerate(zip(paths, unchanged, strict=True))
    ]

    def write(made: Path) -> None:
        for number, (path, file, same) in enumerate(zip(paths, names, unchanged, strict=True)):
            progress("frames", number, len(paths))
            if same:
                shutil.copyfile(path, made / file)
            else:
                image = turned_image(read_photo(path, upright=False), turns)
                image.save(made / file, quality=95, subsampling=0)
        progress("frames", len(paths), len(paths))

    kept = stages.folder(name, fingerprint(["copied", turns], files=paths), write)
    return [kept / file for file in names]
