"""Where the cameras were, of features that COLMAP has matched: image after image, or all at once."""

import functools
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from splatrl.capture.jerks import jerks, leaps
from splatrl.capture.job import DATABASE, Job, tell

LEAST_INLIERS, LEAST_SHARE, TRIALS = 15, 0.15, 10
"""Features, and their share, that must agree with a pose, and how often one is sought; COLMAP's 30, 0.25 and 3 leave
out images of bare places, whose neighbours on the way then break off too."""
SHARED = 20
"""Points that two images of a model must share to hold together. COLMAP leaves images in a model, anywhere, when it has
taken away all points that joined them to the others, and what hangs on a dozen may be metres off: before a bare wall,
and all that was filmed after it."""
ENOUGH = 0.8
"""Share of images whose pose must be found; where image after image reaches fewer, all are sought at once."""
NARROWER = (1.0, 0.75)
"""Focal lengths from which that begins, times the first guess; it fails from one that is a quarter too long."""
UNEVEN, NEARLY = 4.0, 0.95
"""Jerks of a film's camera from which it is mapped a second way, and the share of the images that this must reach. A
map with more may be bent or right; a second one costs a minute."""


def mapping_options(pycolmap: Any, job: Job) -> Any:
    """COLMAP's options for images that are joined one after another."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1  # with more, sums come in any order
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = job.seed
    options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = LEAST_INLIERS, LEAST_SHARE
    options.mapper.max_reg_trials = TRIALS
    options.mapper.init_min_tri_angle /= 2  # COLMAP's preset for video, here and below
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.4
    options.min_model_size = min(options.min_model_size, max(3, len(job.names) // 2))
    if job.fixed:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    return options


def find_cameras(pycolmap: Any, folder: Path, job: Job) -> Any:
    """COLMAP's model of the cameras, image after image, or all at once where that is better; None where there is none.

    Args:
        pycolmap: the module.
        folder: of the job, with the database of its matches.
        job: without known poses.
    """
    at_once = functools.cache(functools.partial(map_at_once, pycolmap, folder, job))
    found = map_one_by_one(pycolmap, folder, job)
    for share in (1.0,) if job.fixed else NARROWER:
        if len(joined(found)) >= ENOUGH * len(job.names):
            break
        found = _largest([found, at_once(share)])
    uneven = _jerks(found, job)
    if uneven > UNEVEN:
        other = at_once(1.0)
        if len(joined(other)) >= NEARLY * len(joined(found)) and _jerks(other, job) < uneven:
            return other
    return found


def map_one_by_one(pycolmap: Any, folder: Path, job: Job) -> Any:
    """The largest model that grows from a first pair, image by image; None where there is none."""
    (folder / "sparse").mkdir(exist_ok=True)
    options, done = mapping_options(pycolmap, job), [1]

    def next_image() -> None:
        done[0] += 1
        tell("map", min(done[0], len(job.names)), len(job.names))

    models = pycolmap.incremental_mapping(
        folder / DATABASE, job.images, folder / "sparse", options, next_image_callback=next_image
    )
    return _largest([*models.values()])


def map_at_once(pycolmap: Any, folder: Path, job: Job, share: float = 1.0) -> Any:
    """The largest model by global mapping (Pan et al. 2024), which needs no first pair: photos along a road have no
    good one. None where there is none.

    Args:
        pycolmap: the module.
        folder: of the job, with the database of its matches, which stays as it is.
        job: without known poses.
        share: the focal length with which it begins, times the first guess.
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
    tell("map at once", 0, mapper.ba_num_iterations)  # COLMAP says when each of them has ended
    models = pycolmap.global_mapping(own / DATABASE, job.images, own, options)
    shutil.rmtree(own)
    return _largest([*models.values()])


def _largest(models: list[Any]) -> Any:
    """The one with the most images that hold together, the first of equals; None where there is none."""
    return max((model for model in models if model is not None), key=lambda model: len(joined(model)), default=None)


def _jerks(model: Any, job: Job) -> float:
    """How unevenly the camera of a film went; 0 where nothing says when images were taken."""
    if job.seconds is None:
        return 0.0
    images, places = camera_places(model, job)
    return jerks(leaps(places, np.array(job.seconds)[images]))


def camera_places(model: Any, job: Job) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers [N] of the job's images that hold together in a model, ascending, and where the camera was [N, 3]."""
    numbers = {name: number for number, name in enumerate(job.names)}
    held = {} if model is None else {numbers[model.images[one].name]: model.images[one] for one in joined(model)}
    images = np.array(sorted(held), np.int64)
    return images, np.array([held[one].cam_from_world().inverse().translation for one in images]).reshape(-1, 3)


def joined(model: Any) -> set[int]:
    """The images, by COLMAP's numbers, of the largest part of a model that holds together."""
    if model is None:
        return set()
    images = np.array(sorted(image.image_id for image in model.images.values() if image.has_pose), np.int64)
    tracks = [{element.image_id for element in point.track.elements} for point in model.points3D.values()]
    rows = np.searchsorted(images, [number for track in tracks for number in track])
    columns = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    sees = csr_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(len(images), len(tracks)))
    parts = connected_components((sees @ sees.T).toarray() >= SHARED, directed=False)[1]
    return set(images[parts == np.bincount(parts).argmax()].tolist()) if len(images) else set()
