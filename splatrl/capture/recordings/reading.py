"""Reads whatever recording a path leads to, with one module per kind."""

from pathlib import Path

import numpy as np

from splatrl.capture.base import CaptureError, Photos
from splatrl.capture.lens import Floats
from splatrl.capture.progress import Progress, silent
from splatrl.capture.recordings import colmap, polycam, record3d, stray_scanner, transforms
from splatrl.capture.recordings.base import Recording
from splatrl.capture.recordings.keeping import keep
from splatrl.capture.recordings.prepared import as_prepared

KINDS = (polycam, stray_scanner, record3d, transforms, colmap)
"""Modules with ``found`` and ``read``; the first whose ``found`` accepts a path reads it."""


def is_recording(source: Path) -> bool:
    """Return whether a path leads to a recording that knows its poses.

    Args:
        source: a file or a folder.
    """
    return any(kind.found(source) for kind in KINDS)


def read_recording(
    source: Path, folder: Path, count: tuple[int, int] = (120, 200), longest: int = 960, progress: Progress = silent
) -> Photos:
    """Read images with known poses, as one camera without lens distortion sees them.

    Images that were chosen and prepared already (``transforms.json``, a COLMAP model) stay as they are where they share
    one lens and either come without depth or have lens distortion, which is taken out while the depth is ignored. All
    others are turned upright, after a choice as from a video where they were not prepared, and shown as one camera
    would have seen them: an autofocus changes the focal length by a few per mille, and COLMAP may find a lens for each.

    Args:
        source: ``transforms.json`` or its folder; a folder with a COLMAP model in it, in ``sparse`` or a sub-folder of
            that, and ``images``; a folder of Polycam's raw data or of Stray Scanner; Record3D's ``.r3d`` or its folder.
        folder: the capture's folder; images are written to its sub-folder ``shots``, or ``recorded`` where they were
            prepared already but cannot stay where they are.
        count: minimum (where there are so many) and maximum number of images that are chosen.
        longest: maximum pixels along the longer side of those.
        progress: called for every image.

    Returns:
        Images in the order in which they were taken, with K and camera_to_world, and what else the recording knows.

    Raises:
        CaptureError: where it is no such recording, is broken, or is not of one camera.
        ImportError: where the extra ``capture`` is needed but missing.
    """
    kind = next((kind for kind in KINDS if kind.found(source)), None)
    if kind is None:
        raise CaptureError(
            f"{source}: expected transforms.json, a COLMAP model, or a recording of Polycam, Stray Scanner or "
            "Record3D, found none of them"
        )
    recording = kind.read(source)
    check_recording(recording)
    lenses = {shot.lens for shot in recording.shots}
    distorted = any(any(lens.distortion) for lens in lenses)
    measured = any(shot.depth is not None for shot in recording.shots)
    if recording.prepared and len(lenses) == 1 and (distorted or not measured):
        return as_prepared(recording, folder, progress)
    return keep(recording, folder, count, longest, progress)


def check_recording(recording: Recording) -> None:
    """Refuse poses that are not rigid, and intrinsics that make no sense.

    Raises:
        CaptureError: names the recording, and the first such image in it.
    """
    if not recording.shots:
        raise CaptureError(f"{recording.source}: expected at least one image, got none")
    for shot in recording.shots:
        fault, lens = _fault(shot.camera_to_world), shot.lens
        if fault:
            raise CaptureError(
                f"{recording.source}: {shot.name}: expected a pose of a rotation and a finite position, got {fault}"
            )
        numbers = (lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)
        if not np.isfinite(numbers).all() or min(lens.width, lens.height, lens.fx, lens.fy) <= 0:
            raise CaptureError(
                f"{recording.source}: {shot.name}: expected finite intrinsics with positive focal lengths, got {lens}"
            )
    places = np.array([shot.camera_to_world[:3, 3] for shot in recording.shots])
    if len(places) > 1 and not np.ptp(places, axis=0).any():
        raise CaptureError(
            f"{recording.source}: expected poses at different positions, got all of them at one; a recording with the "
            "front camera has no poses, so capture its images alone"
        )


def _fault(pose: Floats) -> str | None:
    """Return what is wrong with a pose [4, 4]; None if it is rigid."""
    if not np.isfinite(pose).all():
        return "numbers that are not finite"
    axes = pose[:3, :3]
    if np.allclose(axes @ axes.T, np.eye(3), atol=1e-3):
        return "a reflection: its axes are left-handed" if np.linalg.det(axes) < 0 else None
    lengths = np.linalg.norm(axes, axis=0)
    if np.ptp(lengths) < 1e-3 * lengths.max():
        return f"axes of length {lengths[0]:.4g}: is it scaled?"
    return f"axes of lengths {', '.join(f'{length:.4g}' for length in lengths)}, or that are not perpendicular"
