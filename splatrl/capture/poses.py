"""Third stage: where each image was taken, and points that the cameras saw, by structure from motion."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from splatrl.array_files import read_arrays
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.carrying import carried
from splatrl.capture.child import run_child
from splatrl.capture.lens import Lens
from splatrl.capture.progress import Progress, silent
from splatrl.capture.sfm import mapping, structure
from splatrl.capture.sfm.job import Job, write_job
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.undistort import undistorted
from splatrl.extras import require


def find_poses(
    photos: Photos,
    folder: Path,
    seed: int = 0,
    progress: Progress = silent,
    exact_camera: bool = False,
    least: float = mapping.ENOUGH,
) -> Reconstruction:
    """Find the pose of every image, the camera's intrinsics, and points; just the points where the poses are known.

    A second call with the same images and settings reads what the first one kept; after a kill, it resumes. The same
    images and seed give the same result.

    Args:
        photos: photos of one place, taken with one camera; without lens distortion where the poses are known.
        folder: the capture's folder; results are written to its sub-folders ``structure`` and ``undistorted``, or,
            where masks of what moved are given, to folders with the name of the masks' after theirs.
        seed: seed of every random sample.
        progress: called for images, pairs of images and cameras.
        exact_camera: whether ``photos.K`` is exact and the images are without lens distortion; otherwise it is a first
            guess. Known poses need an exact camera, so with them this is taken for granted.
        least: minimum fraction of images whose pose must be found.

    Returns:
        Cameras and points, with images that have no lens distortion.

    Raises:
        CaptureError: where too few poses are found; says which parts of the video could not be joined.
        ImportError: without the extra ``capture``.
        ValueError: for known poses, or an exact camera, without K.
    """
    check_libraries()
    exact_camera = exact_camera or photos.camera_to_world is not None
    if exact_camera and photos.K is None:
        raise ValueError("photos.K: expected intrinsics, as poses are known or the camera is exact, got none")
    stages = Stages(folder)
    job = job_of(photos, seed, exact_camera)
    version = str(getattr(require("pycolmap", "capture"), "__version__", ""))
    recipe = asdict(job) | {"images": None, "mask": None, "pycolmap": version}
    del recipe["moving"]  # the masks count as files, and without any the poses are those of captures before
    masks = [] if photos.mask is None else [photos.mask]
    masks += [] if photos.moving is None else sorted(photos.moving.glob("*.png"))
    work = stages.workplace(f"structure{_ending(photos)}", fingerprint(recipe, files=[*photos.paths, *masks]))
    try:
        model = read_arrays(work / structure.MODEL)
    except (FileNotFoundError, ValueError):  # nothing there yet, or damaged
        write_job(work, job)
        run_child("splatrl.capture.sfm.structure", work, progress)
        model = read_arrays(work / structure.MODEL)
    _check_share(photos, model["images"], least)
    return _reconstruction(photos, model, stages, exact_camera, progress)


def check_libraries() -> None:
    """Raise an ImportError that says how to install the extra ``capture`` if it is missing, before any work is done."""
    require("pycolmap", "capture")
    require("cv2", "capture")


def job_of(photos: Photos, seed: int = 0, exact_camera: bool = False) -> Job:
    """Return the job that ``find_poses`` does with the same arguments."""
    folder = photos.paths[0].parent
    if any(path.parent != folder for path in photos.paths):
        raise ValueError("photos.paths: expected images in one folder, got several folders")
    return Job(
        images=str(folder.resolve()),
        names=[path.name for path in photos.paths],
        width=photos.width,
        height=photos.height,
        K=None if photos.K is None else photos.K.tolist(),
        fixed=exact_camera,
        camera_to_world=None if photos.camera_to_world is None else photos.camera_to_world.tolist(),
        seed=seed,
        seconds=None if photos.files else photos.seconds.tolist(),
        cuts=photos.cuts,
        mask=None if photos.mask is None else str(photos.mask),
        moving=None if photos.moving is None else str(photos.moving),
    )


def _ending(photos: Photos) -> str:
    """Return what the names of the folders end in, so that a capture keeps the poses with and without masks."""
    return "" if photos.moving is None else f"_{photos.moving.name}"


def _check_share(photos: Photos, found: np.ndarray, least: float) -> None:
    count = len(photos.paths)
    if len(found) >= max(2, least * count):
        return
    missing = ", ".join(missing_parts(photos, found))
    raise CaptureError(
        f"tracking lost: only {len(found)} of {count} images could be registered ({len(found) / count:.0%}; at least "
        f"{least:.0%} are needed). Missing: {missing}. Film these parts and the way to them again, more "
        "slowly and with more overlap, and turn in a curve rather than on the spot; --force leaves these parts out."
    )


def missing_parts(photos: Photos, found: np.ndarray) -> tuple[str, ...]:
    """Return the longest stretches of images without a pose in words, by the names of their files or their times.

    Args:
        photos: all images.
        found: indices of the images with a pose.
    """
    names = photos.files or [f"{seconds:.1f} s" for seconds in photos.seconds.tolist()]
    return tuple(
        names[first] if first == last else f"{names[first]} to {names[last]} ({last - first + 1} images)"
        for first, last in missing_runs(found, len(photos.paths))
    )


def missing_runs(found: np.ndarray, count: int, most: int = 4) -> list[tuple[int, int]]:
    """Return the longest stretches of images without a pose.

    Args:
        found: indices of the images with a pose.
        count: number of images.
        most: maximum number of stretches to return.

    Returns:
        First and last image of each, in the order in which they were taken.
    """
    missing = np.setdiff1d(np.arange(count), found)
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1) if len(missing) else []
    longest = sorted(runs, key=len, reverse=True)[:most]
    return sorted((int(run[0]), int(run[-1])) for run in longest)


def _reconstruction(
    photos: Photos, model: dict[str, np.ndarray], stages: Stages, exact_camera: bool, progress: Progress
) -> Reconstruction:
    images = model["images"].tolist()
    fx, fy, cx, cy, *distortion = model["camera"].tolist()
    lens = Lens(photos.width, photos.height, fx, fy, cx, cy, tuple(distortion), bool(model["fisheye"]))
    paths, mask, ending = [photos.paths[number] for number in images], photos.mask, _ending(photos)
    straight = lens
    if not exact_camera:
        if mask is not None:
            (mask,), _ = undistorted([mask], lens, stages, f"undistorted_mask{ending}")
        paths, straight = undistorted(paths, lens, stages, f"undistorted{ending}", progress)
    film = not photos.files and photos.camera_to_world is None
    seen = model["points"], model["seen_point"], model["seen_by"]
    return Reconstruction(
        paths=paths,
        width=photos.width,
        height=photos.height,
        K=torch.from_numpy(straight.K(straight.size)),
        camera_to_world=_tensor(model, "camera_to_world"),
        points=_tensor(model, "points"),
        colors=_tensor(model, "colors"),
        seen_point=_tensor(model, "seen_point"),
        seen_by=_tensor(model, "seen_by"),
        missing=1 - len(images) / len(photos.paths),
        lost=missing_parts(photos, model["images"]),
        depths=tuple(photos.depths[number] for number in images) if photos.depths else (),
        seconds=None if photos.files else photos.seconds[torch.tensor(images, dtype=torch.int64)],
        gps=None if photos.gps is None else photos.gps[torch.tensor(images, dtype=torch.int64)],
        turned=None if photos.turned is None else photos.turned[torch.tensor(images, dtype=torch.int64)],
        cuts=photos.cuts,
        focal_lengths=_tensor(model, "focal_lengths") if len(model["focal_lengths"]) else None,
        carried=torch.from_numpy(carried(model["camera_to_world"][:, :3, 3], *seen)) if film else None,
        mask=mask,
        numbers=_tensor(model, "images"),
        lens=lens if straight != lens else None,
    )


def _tensor(model: dict[str, np.ndarray], name: str) -> Tensor:
    return torch.from_numpy(model[name])
