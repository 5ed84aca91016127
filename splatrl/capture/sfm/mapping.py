"""Camera poses from features that COLMAP has matched, by incremental or by global mapping."""

import functools
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from splatrl.capture.carrying import carried, longest_stretch
from splatrl.capture.jerks import jerks, leaps
from splatrl.capture.sfm.fisheye import fisheye, match_through
from splatrl.capture.sfm.job import DATABASE, Job, tell

LEAST_INLIERS, LEAST_SHARE, TRIALS = 15, 0.15, 10
"""Minimum number and minimum ratio of inliers of a pose, and how often a pose is sought. COLMAP's 30, 0.25 and 3 leave
out images of bare places, and then lose their neighbours along the way as well."""
SHARED = 20
"""Minimum number of points that two images of a model must share to hold together. COLMAP leaves images in a model,
anywhere, after it has removed all points that joined them to the others, and images that hang on a dozen points may be
metres off: in front of a bare wall, together with all that was filmed after it."""
ENOUGH = 0.8
"""Minimum fraction of images whose pose must be found; below it, incremental mapping is followed by global mapping."""
NARROWER = (1.0, 0.75)
"""Initial focal lengths of global mapping, times the first guess; it fails from one that is a quarter too long."""
UNEVEN, NEARLY = 4.0, 0.95
"""Jerk of a film's camera above which it is mapped a second way, and the fraction of the first map's images that the
second must reach. A map with a larger jerk may be bent or right; a second one costs a minute."""


def mapping_options(pycolmap: Any, job: Job) -> Any:
    """Return COLMAP's options for incremental mapping."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1  # with more, the order of sums varies
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = job.seed
    options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = LEAST_INLIERS, LEAST_SHARE
    options.mapper.max_reg_trials = TRIALS
    options.mapper.init_min_tri_angle /= 2  # as in COLMAP's preset for video, here and below
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.4
    options.min_model_size = min(options.min_model_size, max(3, len(job.names) // 2))
    if job.fixed:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    return options


def find_cameras(pycolmap: Any, folder: Path, job: Job) -> Any:
    """Find the cameras by incremental mapping, or by global mapping where that is better.

    Where incremental mapping shows that the lens is a fisheye, the images are matched and mapped again through one.

    Args:
        pycolmap: the module.
        folder: the job's folder, which holds COLMAP's database of matches.
        job: the job description; its images have no known poses.

    Returns:
        COLMAP's model of the cameras; None where there is none.
    """
    at_once = functools.cache(functools.partial(map_at_once, pycolmap, folder, job))
    found = map_one_by_one(pycolmap, folder, job)
    if found is not None and not job.fixed and (camera := fisheye(pycolmap, found)) is not None:
        match_through(pycolmap, folder, job, camera)
        found = map_one_by_one(pycolmap, folder, job)
    for share in (1.0,) if job.fixed else NARROWER:
        if len(joined(found, job)) >= ENOUGH * len(job.names):
            break
        found = _largest([found, at_once(share)], job)
    uneven = _jerks(found, job)
    if uneven > UNEVEN:
        other = at_once(1.0)
        if len(joined(other, job)) >= NEARLY * len(joined(found, job)) and _jerks(other, job) < uneven:
            return other
    return found


def map_one_by_one(pycolmap: Any, folder: Path, job: Job) -> Any:
    """Return the largest model that incremental mapping grows from an initial pair; None where there is none."""
    (folder / "sparse").mkdir(exist_ok=True)
    options, done = mapping_options(pycolmap, job), [1]

    def next_image() -> None:
        done[0] += 1
        tell("map", min(done[0], len(job.names)), len(job.names))

    models = pycolmap.incremental_mapping(
        folder / DATABASE, job.images, folder / "sparse", options, next_image_callback=next_image
    )
    return _largest([*models.values()], job)


def map_at_once(pycolmap: Any, folder: Path, job: Job, share: float = 1.0) -> Any:
    """Return the largest model by global mapping (Pan et al. 2024); None where there is none.

    Global mapping needs no initial pair: photos along a road have no good one.

    Args:
        pycolmap: the module.
        folder: the job's folder, which holds COLMAP's database of matches; the database is left unchanged.
        job: the job description; its images have no known poses.
        share: initial focal length, times the first guess.
    """
    least = mapping_options(pycolmap, job).min_model_size
    options = pycolmap.GlobalPipelineOptions(num_threads=1, random_seed=job.seed, min_model_size=least)
    mapper = options.mapper
    mapper.num_threads, mapper.random_seed = 1, job.seed
    for part in (mapper.rotation_averaging, mapper.global_positioning, mapper.retriangulation):
        part.random_seed = job.seed
    bundle = mapper.bundle_adjustment
    bundle.ceres.solver_options.num_threads = 1
    mapper.global_positioning.use_gpu = bundle.ceres.use_gpu = False
    if job.fixed:
        bundle.refine_focal_length = bundle.refine_extra_params = False
    own = folder / "at_once"
    shutil.rmtree(own, ignore_errors=True)
    own.mkdir()
    shutil.copy(folder / DATABASE, own / DATABASE)
    if share < 1.0:
        database = pycolmap.Database.open(own / DATABASE)
        camera = database.read_all_cameras()[0]
        camera.focal_length *= share
        database.update_camera(camera)
        database.close()
    tell("map globally", 0, mapper.ba_num_iterations)  # COLMAP prints the end of each iteration
    models = pycolmap.global_mapping(own / DATABASE, job.images, own, options)
    shutil.rmtree(own)
    return _largest([*models.values()], job)


def _largest(models: list[Any], job: Job) -> Any:
    """Return the model with the most images that hold together, the first of equals; None where there is none."""
    found = (model for model in models if model is not None)
    return max(found, key=lambda model: len(joined(model, job)), default=None)


def _jerks(model: Any, job: Job) -> float:
    """Return how unevenly the camera of a film moved; 0 where the capture times are unknown."""
    if job.seconds is None:
        return 0.0
    images, places = camera_places(model, job)
    return jerks(leaps(places, np.array(job.seconds)[images], job.cuts))


def camera_places(model: Any, job: Job) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return which of the job's images hold together in a model, [N] ascending indices, and their positions [N, 3]."""
    numbers = {name: number for number, name in enumerate(job.names)}
    held = {} if model is None else {numbers[model.images[one].name]: one for one in joined(model, job)}
    images = sorted(held)
    return np.array(images, np.int64), _places(model, np.array([held[one] for one in images], np.int64))


def joined(model: Any, job: Job) -> set[int]:
    """Return the COLMAP ids of the images in the largest part of a model that holds together.

    A film is also parted where its scale is not carried on.

    Args:
        model: COLMAP's model; None where there is none.
        job: the job description; the ids of its images ascend as their names do.
    """
    if model is None:
        return set()
    images = np.array(sorted(image.image_id for image in model.images.values() if image.has_pose), np.int64)
    if not len(images):
        return set()
    points, seen_point, seen_by = _sightings(model, images)
    sees = csr_array((np.ones(len(seen_by), np.int32), (seen_by, seen_point)), shape=(len(images), len(points)))
    parts = connected_components((sees @ sees.T).toarray() >= SHARED, directed=False)[1]
    held = parts == np.bincount(parts).argmax()
    images, counted = images[held], held[seen_by]
    if job.seconds is not None:
        seen_by = (np.cumsum(held) - 1)[seen_by[counted]]
        images = images[longest_stretch(carried(_places(model, images), points, seen_point[counted], seen_by))]
    return set(images.tolist())


def least_carried(model: Any, job: Job) -> float:
    """Return how well the scale of a film is carried on where that is worst, among the images that hold together."""
    images = np.array(sorted(joined(model, job)), np.int64)
    return float(carried(_places(model, images), *_sightings(model, images)).min()) if len(images) else 0.0


def _places(model: Any, images: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the positions [N, 3] of the cameras that took images, by their ids."""
    found = [model.images[one].cam_from_world().inverse().translation for one in images.tolist()]
    return np.array(found).reshape(-1, 3)


def _sightings(
    model: Any, images: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the points of a model [P, 3], and the point and the image of each sighting, as ``carried`` takes them.

    Args:
        model: COLMAP's model.
        images: [N] ids of the images that count, ascending.
    """
    points = np.array([point.xyz for point in model.points3D.values()], np.float64).reshape(-1, 3)
    tracks = [{element.image_id for element in point.track.elements} for point in model.points3D.values()]
    seen_by = np.array([number for track in tracks for number in sorted(track)], np.int64)
    counted = np.isin(seen_by, images)
    seen_point = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    return points, seen_point[counted], np.searchsorted(images, seen_by[counted])
