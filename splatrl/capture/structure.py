"""Structure from motion with COLMAP, in a process of its own: ``python -m splatrl.capture.structure JOB``.

COLMAP aborts where another thread reads its database, and its logs are its only progress; a process of its own can be
killed at any time. What is in the database when that happens is not computed again. The process ends when its standard
input closes, so that it never outlives the caller.
"""

import json
import os
import shutil
import sqlite3
import sys
import threading
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from splatrl.capture.jerks import jerks, leaps
from splatrl.capture.loops import loop_pairs
from splatrl.files import replacing

MODEL, DATABASE, PAIRS, JOB, SEARCHED = "model.npz", "database.db", "pairs.txt", "job.json", "searched"
FEATURES = 4096
FAINTEST = 0.003
"""Contrast of a feature, at least; with COLMAP's 0.0067 shaded walls and lawns hold too few."""
FEW, FAINTER = 1000, 0.0008
"""An image with fewer features is searched again for fainter ones: blurred, or bare walls and sky."""
LEAST_INLIERS, LEAST_SHARE, TRIALS = 15, 0.15, 10
"""Features, and their share, that must agree with a pose, and how often one is sought; COLMAP's 30, 0.25 and 3 leave
out images of bare places, whose neighbours on the way then break off too."""
SHARED = 10
"""Points that two images of a model must share to hold together: COLMAP leaves images in a model, anywhere, when it has
taken away all points that joined them to the others."""
ENOUGH = 0.8
"""Share of images whose pose must be found; where image after image reaches fewer, all are sought at once."""
NARROWER = (1.0, 0.75)
"""Focal lengths from which that begins, times the first guess; it fails from one that is a quarter too long."""
UNEVEN, NEARLY = 4.0, 0.95
"""Jerks of a film's camera from which it is mapped a second way, and the share of the images that this must reach. A
map with more may be bent or right; a second one costs a minute."""
SPARSE = 40
"""Up to so many images: all pairs, and features from the doubled image, as photos far from each other need."""


@dataclass(frozen=True)
class Job:
    """What to reconstruct.

    Attributes:
        images: folder of the images.
        names: of the images, in the order in which they were taken.
        width: of every image, pixels.
        height: of every image, pixels.
        K: [3][3] intrinsics, pixels; None where unknown.
        fixed: whether K is exact and the images are without lens distortion.
        camera_to_world: [N][4][4] known poses, which stay as they are; None where they are to be found.
        seed: of every random sample.
        seconds: [N] when each image of a film was taken, ascending; None for photos.
    """

    images: str
    names: list[str]
    width: int
    height: int
    K: list[list[float]] | None = None
    fixed: bool = False
    camera_to_world: list[list[list[float]]] | None = None
    seed: int = 0
    seconds: list[float] | None = None


def write_job(folder: Path, job: Job) -> None:
    """Describe a job in the folder where its results are to appear."""
    with replacing(folder / JOB) as stream:
        stream.write(json.dumps(asdict(job)).encode())


def pairs(count: int) -> list[tuple[int, int]]:
    """The pairs of images to match: neighbours near and far, and every tenth with every other tenth.

    Args:
        count: how many images there are.

    Returns:
        The smaller number first, ascending.
    """
    if count <= SPARSE:
        return [(first, second) for first in range(count) for second in range(first + 1, count)]
    chosen = {(i, i + offset) for offset in (*range(1, 9), 16, 32) for i in range(count - offset)}
    chosen |= {(first, second) for first in range(0, count, 10) for second in range(first + 10, count, 10)}
    return sorted(chosen)


def run(folder: Path) -> None:
    """Do the job of a folder.

    Args:
        folder: with ``job.json``; ``model.npz`` appears in it.
    """
    import pycolmap

    job = Job(**json.loads((folder / JOB).read_text("utf-8")))
    pycolmap.set_random_seed(job.seed)
    _extract(pycolmap, folder, job)
    _match(pycolmap, folder, job)
    _tell("map", 0, len(job.names))
    options = _mapping_options(pycolmap, job)
    if job.camera_to_world is None:
        model = _map(pycolmap, folder, job, options)
    else:
        model = _triangulate(pycolmap, folder, job, options)
    _keep(folder, job, model)


def _extract(pycolmap: Any, folder: Path, job: Job) -> None:
    """One camera for all images, with square pixels: a camera that never rolls does not show its fx and fy apart."""
    database = folder / DATABASE
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE" if job.fixed else "RADIAL")
    if job.K is not None:
        intrinsics = [job.K[0][0], job.K[1][1], job.K[0][2], job.K[1][2]]
        reader.camera_params = ", ".join(map(repr, intrinsics if job.fixed else [*intrinsics[1:], 0.0, 0.0]))
    if not database.exists():  # before any features, so that the numbers of the images follow their order
        pycolmap.Database.open(database).close()
    pycolmap.import_images(database, job.images, pycolmap.CameraMode.SINGLE, job.names, reader)
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = FEATURES
    options.sift.peak_threshold = FAINTEST
    options.sift.first_octave = -1 if len(job.names) <= SPARSE else 0

    def extract(names: list[str]) -> None:
        pycolmap.extract_features(
            database, job.images, names, pycolmap.CameraMode.SINGLE, reader, options, pycolmap.Device.cpu
        )

    extract(job.names)
    if (folder / SEARCHED).exists():
        return
    options.sift.peak_threshold = FAINTER
    if poor := _without_features(database):
        extract(poor)
    (folder / SEARCHED).touch()


def _without_features(database: Path) -> list[str]:
    """Take away the features of images that have few, so that COLMAP searches them again; returns their names.

    Where a second search was interrupted, those that it had reached already are searched once more, or had enough.
    """
    with closing(sqlite3.connect(database)) as connection, connection:
        few = connection.execute("SELECT image_id FROM keypoints WHERE rows < ? ORDER BY image_id", (FEW,)).fetchall()
        for table in ("keypoints", "descriptors"):
            connection.executemany(f"DELETE FROM {table} WHERE image_id = ?", few)
        names = "SELECT name FROM images WHERE image_id NOT IN (SELECT image_id FROM keypoints) ORDER BY image_id"
        return [name for (name,) in connection.execute(names)]


def _match(pycolmap: Any, folder: Path, job: Job) -> None:
    chosen = pairs(len(job.names))
    if len(job.names) > SPARSE:
        chosen = sorted({*chosen, *loop_pairs(_descriptors(pycolmap, folder, job))})
    lines = [f"{job.names[first]} {job.names[second]}\n" for first, second in chosen]
    (folder / PAIRS).write_text("".join(lines), "utf-8")
    pairing = pycolmap.ImportedPairingOptions(block_size=50, match_list_path=str(folder / PAIRS))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job.seed
    options = pycolmap.FeatureMatchingOptions(num_threads=1)  # with two, a pair in a thousand differs from run to run
    pycolmap.match_image_pairs(folder / DATABASE, options, pairing, verification, pycolmap.Device.cpu)


def _descriptors(pycolmap: Any, folder: Path, job: Job) -> list[np.ndarray]:
    """Of every image, in the order in which they were taken."""
    database = pycolmap.Database.open(folder / DATABASE)
    numbers = {image.name: image.image_id for image in database.read_all_images()}
    found = [database.read_descriptors(numbers[name]) for name in job.names]
    database.close()
    return [np.asarray(getattr(one, "data", one), np.uint8).reshape(-1, 128) for one in found]


def _mapping_options(pycolmap: Any, job: Job) -> Any:
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


def _map(pycolmap: Any, folder: Path, job: Job, options: Any) -> Any:
    (folder / "sparse").mkdir(exist_ok=True)
    done = [1]

    def next_image() -> None:
        done[0] += 1
        _tell("map", min(done[0], len(job.names)), len(job.names))

    models = pycolmap.incremental_mapping(
        folder / DATABASE, job.images, folder / "sparse", options, next_image_callback=next_image
    )
    found = _largest([*models.values()])
    for share in (1.0,) if job.fixed else NARROWER:
        if len(_joined(found)) >= ENOUGH * len(job.names):
            break
        found = _largest([found, *_map_at_once(pycolmap, folder, job, options.min_model_size, share)])
    uneven = _jerks(found, job)
    if uneven > UNEVEN:
        other = _largest(_map_at_once(pycolmap, folder, job, options.min_model_size, 1.0))
        if len(_joined(other)) >= NEARLY * len(_joined(found)) and _jerks(other, job) < uneven:
            return other
    return found


def _jerks(model: Any, job: Job) -> float:
    """How unevenly the camera of a film went; 0 where nothing says when images were taken."""
    if job.seconds is None or model is None:
        return 0.0
    when = dict(zip(job.names, job.seconds, strict=True))
    images = sorted((model.images[number] for number in _joined(model)), key=lambda image: when[image.name])
    places = np.array([image.cam_from_world().inverse().translation for image in images]).reshape(-1, 3)
    return jerks(leaps(places, np.array([when[image.name] for image in images])))


def _map_at_once(pycolmap: Any, folder: Path, job: Job, least: int, share: float) -> list[Any]:
    """Models by global mapping (Pan et al. 2024), which needs no first pair: photos along a road have no good one."""
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
    _tell("map at once", 0, mapper.ba_num_iterations)  # COLMAP says when each of them has ended
    models = pycolmap.global_mapping(own / DATABASE, job.images, own, options)
    shutil.rmtree(own)
    return [*models.values()]


def _largest(models: list[Any]) -> Any:
    """The one with the most images that hold together, the first of equals; None where there is none."""
    return max((model for model in models if model is not None), key=lambda model: len(_joined(model)), default=None)


def _joined(model: Any) -> set[int]:
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


def _triangulate(pycolmap: Any, folder: Path, job: Job, options: Any) -> Any:
    (folder / "sparse").mkdir(exist_ok=True)
    database = pycolmap.Database.open(folder / DATABASE)
    cameras, images = database.read_all_cameras(), database.read_all_images()
    database.close()
    camera_to_world = dict(zip(job.names, np.asarray(job.camera_to_world), strict=True))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(cameras[0])
    for image in images:
        world_to_camera = np.linalg.inv(camera_to_world[image.name])
        placed = pycolmap.Image(
            name=image.name, keypoints=np.zeros((0, 2)), camera_id=cameras[0].camera_id, image_id=image.image_id
        )
        model.add_image_with_trivial_frame(placed, pycolmap.Rigid3d(world_to_camera[:3]))
    return pycolmap.triangulate_points(model, folder / DATABASE, job.images, folder / "sparse", True, options)


def _keep(folder: Path, job: Job, model: Any) -> None:
    if model is None:
        found = {}
    elif job.camera_to_world is not None:
        found = {image.name: image for image in model.images.values()}
    else:
        found = {model.images[number].name: model.images[number] for number in _joined(model)}
    images = [number for number, name in enumerate(job.names) if name in found]
    camera_to_world = np.zeros((len(images), 4, 4))
    for row, number in enumerate(images):
        camera_to_world[row, :3] = found[job.names[number]].cam_from_world().inverse().matrix()
        camera_to_world[row, 3, 3] = 1
    rows = {found[job.names[number]].image_id: row for row, number in enumerate(images)}
    points, sightings = [], []
    for _, point in [] if model is None else sorted(model.points3D.items()):
        cameras = sorted({rows[e.image_id] for e in point.track.elements if e.image_id in rows})
        if len(cameras) > 1:
            points.append(point)
            sightings.append(cameras)
    with replacing(folder / MODEL) as stream:
        np.savez(
            stream,
            images=np.array(images, np.int64),
            camera_to_world=camera_to_world,
            camera=np.zeros(0) if model is None else _opencv(next(iter(model.cameras.values()))),
            points=np.array([point.xyz for point in points]).reshape(-1, 3),
            colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
            seen_point=np.repeat(np.arange(len(points)), [len(cameras) for cameras in sightings]),
            seen_by=np.array([row for cameras in sightings for row in cameras], np.int64),
        )


def _opencv(camera: Any) -> np.ndarray:
    """OpenCV's fx, fy, cx, cy, k1, k2, p1, p2."""
    parameters = np.zeros(8)
    parameters[:4] = camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y
    if camera.model.name == "RADIAL":
        parameters[4:6] = camera.params[3:]
    return parameters


def _tell(what: str, done: int, total: int) -> None:
    print(json.dumps([what, done, total]), flush=True)


def _end_with_the_caller() -> None:
    while os.read(0, 4096):  # not sys.stdin, whose lock the interpreter wants at its end
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_caller, daemon=True).start()
    run(Path(sys.argv[1]))
