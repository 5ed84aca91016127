"""Whether a film or photos were taken through a fisheye, such as an action camera's lens.

Where one maps angles rather than their tangents, COLMAP's usual ``RADIAL`` model cannot describe its bending, and the
place bends instead, without contradicting itself.
"""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatrl.capture.sfm.job import DATABASE, Job
from splatrl.capture.sfm.pairing import match_pairs
from splatrl.capture.sfm.zoom import adjust, mean_error

if TYPE_CHECKING:  # the process that runs COLMAP needs no PyTorch, whose import takes seconds
    from splatrl.capture.base import Reconstruction

FISHEYE = "RADIAL_FISHEYE"
"""COLMAP's name of OpenCV's fisheye model with k1 and k2 alone: it has as many parameters as ``RADIAL``, so it fits no
better for their number. A focal length each for rows and columns would not be certain in films that never roll."""
LESS = 0.02
"""Minimum relative decrease of the mean reprojection error by which a lens is a fisheye: it decreases by 13 % for one
of 118° across, and by at most 0.2 % for the lenses of phones."""


def fisheye(pycolmap: Any, model: Any) -> Any:
    """Return the camera of a model as a fisheye, if that describes the images clearly better; None otherwise.

    Args:
        pycolmap: the module.
        model: COLMAP's model, with one camera for all images, whose model is ``RADIAL`` or was replaced before; it is
            not changed.
    """
    tried = pycolmap.Reconstruction(model)
    camera = next(iter(tried.cameras.values()))
    if camera.model.name == FISHEYE:
        return None
    center = [camera.principal_point_x, camera.principal_point_y]
    camera.model, camera.params = getattr(pycolmap.CameraModelId, FISHEYE), [camera.focal_length, *center, 0.0, 0.0]
    adjust(pycolmap, tried)
    images = [image for image in model.images.values() if image.has_pose]
    return camera if mean_error(tried, images) <= (1.0 - LESS) * mean_error(model, images) else None


def match_through(pycolmap: Any, folder: Path, job: Job, camera: Any) -> None:
    """Write a camera to a job's database, and find anew which matches are right through it.

    Args:
        pycolmap: the module.
        folder: the job's folder.
        job: the job that the folder describes.
        camera: the camera of all images, as ``fisheye`` returns it.
    """
    with closing(pycolmap.Database.open(folder / DATABASE)) as database:
        known = database.read_all_cameras()[0]
        known.model, known.params, known.has_prior_focal_length = camera.model, camera.params, True
        database.update_camera(known)
        database.clear_two_view_geometries()
    match_pairs(pycolmap, folder, job)


def straightened(found: Reconstruction) -> str | None:
    """Return a remark where the images of a reconstruction were taken through a fisheye; None otherwise."""
    if found.lens is None or not found.lens.fisheye:
        return None
    shown = 2.0 * math.degrees(math.atan(found.width / 2.0 / float(found.K[0, 0])))
    return (
        f"the lens is a fisheye; its images were straightened, and show {shown:.0f}° from side to side. The linear or "
        "narrow setting of an action camera gives sharper images, and more exact cameras."
    )
