"""Whether the lens of a film changed: the focal length of each part, from one more bundle adjustment.

One camera is fitted to all images, so a zoom or another lens of the phone bends cameras and points, and nothing else
shows it: the bent place agrees with itself.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.cuts import takes
from splatrl.capture.sfm.job import Job

if TYPE_CHECKING:  # the process that runs COLMAP needs no PyTorch, whose import takes seconds
    from splatrl.capture.base import Reconstruction

Floats = NDArray[np.float64]

PART = 3
"""Number of consecutive images that share a focal length, and minimum number of a take for one of its own."""
LESS = 0.1
"""Minimum relative decrease of a part's mean reprojection error by which a focal length of its own is better than the
common one: it decreases by at most 2 % in films of one lens, by 4 % where a map is torn, and by 15 to 50 % in zooms.
Where a camera walks straight towards a wall, hardly any error tells a longer lens from a nearer camera."""
FAR = 4.0
"""Maximum reprojection error that counts, pixels; COLMAP leaves out what is farther off. The adjustment may move single
points behind a camera, where they have none at all."""
NOTED, REFUSED = 1.07, 1.15
"""Ratio of the longest focal length to the shortest from which a film counts as zoomed, and from which it is refused
(inclusive)."""
STEPS, CLOSE = 50, 1e-4
"""Maximum number of steps of the bundle adjustment, and the relative decrease of its cost below which it ends."""


def focal_lengths(pycolmap: Any, model: Any, job: Job) -> dict[str, float]:
    """Return the focal length of each image of a film, pixels, where each ``PART`` images have one of their own.

    Distortion is that of the common camera: together with it, a focal length is less certain.

    Args:
        pycolmap: the module.
        model: COLMAP's model, with one camera for all images; it is not changed.
        job: the job description, of a film.

    Returns:
        By name of each image with a pose; the common focal length in parts that another does not fit clearly better.
    """
    assert job.seconds is not None
    at = dict(zip(job.names, job.seconds, strict=True))
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: at[image.name])
    common = next(iter(model.cameras.values()))
    several, parts = pycolmap.Reconstruction(), []
    seconds = np.array([at[image.name] for image in images])
    for number, rows in enumerate(_parts(takes(seconds, job.cuts)), 1):
        camera = pycolmap.Camera(
            model=common.model, width=common.width, height=common.height, params=common.params, camera_id=number
        )
        several.add_camera_with_trivial_rig(camera)
        for image in (images[row] for row in rows):
            pixels = pycolmap.Point2DList([pycolmap.Point2D(point.xy) for point in image.points2D])
            same = pycolmap.Image(name=image.name, points2D=pixels, camera_id=number, image_id=image.image_id)
            several.add_image_with_trivial_frame(same, image.cam_from_world())
        parts.append([images[row] for row in rows])
    for _, point in sorted(model.points3D.items()):
        several.add_point3D(point.xyz, point.track, point.color)
    before = [mean_error(several, part) for part in parts]
    adjust(pycolmap, several, refine_extra_params=False)
    focal: dict[str, float] = {}
    for number, part in enumerate(parts, 1):
        better = mean_error(several, part) <= (1.0 - LESS) * before[number - 1]
        camera = several.cameras[number] if better else common
        focal |= {image.name: float(camera.focal_length) for image in part}
    return focal


def adjust(pycolmap: Any, model: Any, **options: bool) -> None:
    """Adjust a COLMAP model by one bundle adjustment.

    Args:
        pycolmap: the module.
        model: the model, which is changed.
        options: COLMAP's options, where they differ from its own.
    """
    adjustment = pycolmap.BundleAdjustmentOptions(print_summary=False, **options)
    solver = adjustment.ceres.solver_options
    solver.num_threads, solver.max_num_iterations, solver.function_tolerance = 1, STEPS, CLOSE
    pycolmap.bundle_adjustment(model, adjustment)


def zoomed(found: Reconstruction, least: float = NOTED) -> str | None:
    """Return a warning where the focal length changes within a film; None where nothing suggests that.

    Args:
        found: a reconstruction in any frame.
        least: minimum ratio of the longest focal length to the shortest.
    """
    if found.focal_lengths is None or found.seconds is None:
        return None
    focal = found.focal_lengths.numpy()
    ratio = float(focal.max() / focal.min())
    if ratio < least:
        return None
    when = float(found.seconds[1 + int(np.abs(np.diff(np.log(focal))).argmax())])
    return (
        f"zoomed: the focal length changes by {100 * (ratio - 1):.0f} % at about {when:.0f} s, but all images must be "
        "of one lens; film without zooming and without switching lenses, or cut that part out."
    )


def _parts(take: NDArray[np.int64]) -> list[list[int]]:
    """Split images, given by their takes [N], into parts of one take with about ``PART`` images each.

    A take of fewer than ``PART`` images belongs to the next one, or at the end to the one before.
    """
    ends = [0]
    for end in (np.flatnonzero(np.diff(take)) + 1).tolist():
        if min(end - ends[-1], len(take) - end) >= PART:
            ends.append(end)
    return [
        rows.tolist()
        for first, last in pairwise([*ends, len(take)])
        for rows in np.array_split(np.arange(first, last), max(1, round((last - first) / PART)))
    ]


def mean_error(model: Any, images: list[Any]) -> float:
    """Return the mean reprojection error of some images in a COLMAP model, pixels."""
    errors, points = [], model.points3D
    for image in (model.images[image.image_id] for image in images):
        seen = image.get_observation_points2D()
        places = np.array([points[point.point3D_id].xyz for point in seen]).reshape(-1, 3)
        world_to_camera = image.cam_from_world().matrix()
        local = places @ world_to_camera[:, :3].T + world_to_camera[:, 3]
        pixels = np.array(model.cameras[image.camera_id].img_from_cam(local), np.float64).reshape(-1, 2)
        off = np.linalg.norm(pixels - np.array([point.xy for point in seen]).reshape(-1, 2), axis=1)
        errors.append(np.where(local[:, 2] > 0, np.fmin(off, FAR), FAR))  # COLMAP projects nothing behind: NaN
    return float(np.concatenate(errors).mean())
