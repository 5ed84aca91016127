"""Structure from motion with COLMAP, in a process of its own: ``python -m splatrl.capture.sfm.structure JOB``.

COLMAP aborts where another thread reads its database, and only its logs show its progress; a process of its own can be
killed at any time. What is in the database by then is not computed again. The process ends when its standard input
closes, so that it never outlives the caller.
"""

import os
import sqlite3
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from splatrl.capture.sfm.fisheye import FISHEYE
from splatrl.capture.sfm.job import DATABASE, Job, read_job, tell
from splatrl.capture.sfm.loops import loop_pairs
from splatrl.capture.sfm.mapping import find_cameras, joined, mapping_options
from splatrl.capture.sfm.pairing import PAIRS, match_pairs
from splatrl.capture.sfm.zoom import focal_lengths
from splatrl.files import replacing

MODEL, SEARCHED = "model.npz", "searched"
FEATURES = 4096
FAINTEST = 0.003
"""Minimum contrast of a feature; with COLMAP's 0.0067, shaded walls and lawns hold too few."""
FEW, FAINTER = 1000, 0.0008
"""Number of features below which an image is searched again, and the minimum contrast then: such images are blurred, or
show bare walls and sky."""
SPARSE = 40
"""Maximum number of images of which all pairs are matched, with features from the doubled image, as photos far from
each other need."""
ALIKE = 20
"""Number of photos that look alike with which each is matched, since those next to it may show another place."""


def pairs(count: int) -> list[tuple[int, int]]:
    """Return the pairs of images to match: neighbours near and far, and every tenth image with every other tenth.

    Args:
        count: number of images.

    Returns:
        Indices of two images each, the smaller one first, ascending.
    """
    if count <= SPARSE:
        return [(first, second) for first in range(count) for second in range(first + 1, count)]
    chosen = {(i, i + offset) for offset in (*range(1, 9), 16, 32) for i in range(count - offset)}
    chosen |= {(first, second) for first in range(0, count, 10) for second in range(first + 10, count, 10)}
    return sorted(chosen)


def run(folder: Path) -> None:
    """Do the job of a folder.

    Args:
        folder: the folder with ``job.json``; ``model.npz`` is written to it.
    """
    import pycolmap

    job = read_job(folder)
    match_images(pycolmap, folder, job)
    tell("map", 0, len(job.names))
    model = find_cameras(pycolmap, folder, job) if job.camera_to_world is None else _triangulate(pycolmap, folder, job)
    film = model is not None and job.seconds is not None and not job.fixed
    _keep(folder, job, model, focal_lengths(pycolmap, model, job) if film else None)


def match_images(pycolmap: Any, folder: Path, job: Job) -> None:
    """Extract features from all images, and match them; what the folder's database already holds is kept.

    Args:
        pycolmap: the module.
        folder: the job's folder.
        job: the job that the folder describes.
    """
    pycolmap.set_random_seed(job.seed)
    _extract(pycolmap, folder, job)
    _match(pycolmap, folder, job)


def _extract(pycolmap: Any, folder: Path, job: Job) -> None:
    """Extract features, with one camera for all images.

    Unless the camera is known, its pixels are taken to be square: a camera that never rolls does not tell fx from fy.
    """
    database = folder / DATABASE
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE" if job.fixed else "RADIAL")
    if job.mask is not None:
        reader.camera_mask_path = job.mask
    if job.moving is not None:  # COLMAP uses both
        reader.mask_path = job.moving
    if job.K is not None:
        intrinsics = [job.K[0][0], job.K[1][1], job.K[0][2], job.K[1][2]]
        reader.camera_params = ", ".join(map(repr, intrinsics if job.fixed else [*intrinsics[1:], 0.0, 0.0]))
    if not database.exists():  # before any features, so that the ids of the images follow their order
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
    """Delete the features of images that have few, so that COLMAP searches them again; return the images' names.

    After an interrupted second search, images that it had already reached are searched once more, unless they now have
    enough.
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
        unordered = job.seconds is None and job.camera_to_world is None
        looks = {"partners": ALIKE, "apart": 1} if unordered else {}
        chosen = sorted({*chosen, *loop_pairs(_descriptors(pycolmap, folder, job), **looks)})
    lines = [f"{job.names[first]} {job.names[second]}\n" for first, second in chosen]
    (folder / PAIRS).write_text("".join(lines), "utf-8")
    match_pairs(pycolmap, folder, job)


def _descriptors(pycolmap: Any, folder: Path, job: Job) -> list[np.ndarray]:
    """Return the descriptors of every image, in the order in which the images were taken."""
    database = pycolmap.Database.open(folder / DATABASE)
    numbers = {image.name: image.image_id for image in database.read_all_images()}
    found = [database.read_descriptors(numbers[name]) for name in job.names]
    database.close()
    return [np.asarray(getattr(one, "data", one), np.uint8).reshape(-1, 128) for one in found]


def _triangulate(pycolmap: Any, folder: Path, job: Job) -> Any:
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
    return pycolmap.triangulate_points(
        model, folder / DATABASE, job.images, folder / "sparse", True, mapping_options(pycolmap, job)
    )


def _keep(folder: Path, job: Job, model: Any, focal: dict[str, float] | None = None) -> None:
    if model is None:
        found = {}
    elif job.camera_to_world is not None:
        found = {image.name: image for image in model.images.values()}
    else:
        found = {model.images[number].name: model.images[number] for number in joined(model, job)}
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
    camera = None if model is None else next(iter(model.cameras.values()))
    with replacing(folder / MODEL) as stream:
        np.savez(
            stream,
            images=np.array(images, np.int64),
            camera_to_world=camera_to_world,
            camera=np.zeros(0) if camera is None else _opencv(camera),
            fisheye=np.array(camera is not None and camera.model.name == FISHEYE),
            focal_lengths=np.array([focal[job.names[number]] for number in images] if focal else [], np.float64),
            points=np.array([point.xyz for point in points]).reshape(-1, 3),
            colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
            seen_point=np.repeat(np.arange(len(points)), [len(cameras) for cameras in sightings]),
            seen_by=np.array([row for cameras in sightings for row in cameras], np.int64),
        )


def _opencv(camera: Any) -> np.ndarray:
    """Return OpenCV's fx, fy, cx, cy, k1, k2, p1, p2, or of a fisheye fx, fy, cx, cy, k1, k2, k3, k4."""
    parameters = np.zeros(8)
    parameters[:4] = camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y
    if camera.model.name in ("RADIAL", FISHEYE):
        parameters[4:6] = camera.params[3:]
    return parameters


def _end_with_the_caller() -> None:
    while os.read(0, 4096):  # not sys.stdin, whose lock the interpreter needs to exit
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_caller, daemon=True).start()
    run(Path(sys.argv[1]))
