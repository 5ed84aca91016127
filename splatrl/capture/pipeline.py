"""All stages of a capture, one after the other; each keeps its result, so that a second call continues."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from splatrl.capture.again import place_again
from splatrl.capture.area import dense_voxels
from splatrl.capture.base import CaptureError, Photos, unless_forced
from splatrl.capture.check import Quality
from splatrl.capture.drift import leap
from splatrl.capture.fitting.fit import held_out
from splatrl.capture.fitting.pictures import frame_of
from splatrl.capture.floaters import without_floaters
from splatrl.capture.folder import share_of, write_scene
from splatrl.capture.frames import read_photos
from splatrl.capture.kept import kept_depths, kept_fit, kept_moving
from splatrl.capture.look import look
from splatrl.capture.placing import place_photos
from splatrl.capture.poses import check_libraries
from splatrl.capture.progress import Progress, Say, silent
from splatrl.capture.recordings import is_recording, read_recording
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.mapping import ENOUGH
from splatrl.capture.stages import Stages
from splatrl.capture.unchanging import said, too_much, with_mask
from splatrl.capture.world import Placed
from splatrl.files import alone_in, remove_stale, require_room
from splatrl.scenes.description import SCENE_FILE, SMALL_SPLAT, SPLAT, check_absent

STAGES = "stages"
"""Sub-folder of a capture in which the stages keep their results; it can be deleted once the scene is there."""


def capture(
    source: Path,
    folder: Path,
    settings: CaptureSettings,
    progress: Progress = silent,
    say: Say = print,
) -> Quality:
    """Make a scene to train in from a video, a folder of photos, or a recording that already has poses.

    Args:
        source: a video, a folder of photos, or whatever ``read_recording`` reads.
        folder: the scene's folder; the stages keep their results in its sub-folder ``stages``.
        settings: settings of the capture.
        progress: called with the progress of each stage.
        say: called with the outcome of each stage, as one line.

    Returns:
        The quality of the capture; the report in ``folder`` says more.

    Raises:
        CaptureError: for a capture that cannot work; says why, and what to do.
        FileExistsError: for an existing scene, without ``force``.
        ImportError: without the extra ``capture``.
        OSError: where the folder cannot be written.
        ValueError: where another process works in the folder.
    """
    if folder.resolve() == source.resolve():  # the next capture would take its pictures for photos
        raise CaptureError(
            f"{folder}: expected a scene folder other than the source, got the source; choose one with --out"
        )
    if (source / SCENE_FILE).is_file() and not is_recording(source):
        raise CaptureError(
            f"{source}: expected a video or a folder of photos, got a scene that was captured already; name its film, "
            f"or train in it: splatrl-train scene={source}/"
        )
    if folder.is_file():
        raise CaptureError(f"{folder}: expected a folder for the scene, got a file; choose another one with --out")
    check_libraries()
    stages = folder / STAGES
    for name in (SCENE_FILE,) if stages.exists() else (SCENE_FILE, SPLAT, SMALL_SPLAT):  # not those of a capture
        check_absent(folder / name, settings.force)
    made = [each for each in (stages, folder) if not each.exists()]
    stages.mkdir(parents=True, exist_ok=True)
    try:
        require_room(folder)
        with alone_in(stages):
            remove_stale(stages)
            placed, notes = reconstruct(source, folder, settings, progress, say)
            return build_scene(placed, folder, settings, notes, progress, say)
    finally:
        for each in made:
            with suppress(OSError):  # not empty: something was kept in it
                each.rmdir()


def reconstruct(
    source: Path,
    folder: Path,
    settings: CaptureSettings,
    progress: Progress = silent,
    say: Say = print,
) -> tuple[Placed, list[str]]:
    """Run the first half of a capture: find where the cameras were, in a world that stands upright.

    Args:
        source: as for ``capture``, like the other arguments.
        folder: the scene's folder.
        settings: settings of the capture.
        progress: called with the progress of each stage.
        say: called with the outcome of each stage.

    Returns:
        The cameras in the world, and the remarks of these stages for the report.

    Raises:
        CaptureError: for a capture that cannot work.
        ImportError: without the extra ``capture``.
    """
    stages = _stages(folder, say)
    stages.place.mkdir(parents=True, exist_ok=True)
    known = is_recording(source)
    if known:
        photos = read_recording(source, stages.place, settings.count, settings.longest, progress)
    else:
        photos = read_photos(source, stages.place, settings.count, settings.longest, progress)
    knows = f", with poses{' and depth' if photos.depths else ''}" if known else ""
    frames = f"frames      {len(photos.paths)} of {photos.width} × {photos.height} pixels{knows}"
    say("\n".join([frames, *(f"            {remark}" for remark in photos.remarks)]))
    photos = with_mask(photos, stages.place, progress)
    notes = [*photos.remarks, *([] if known else _first_look(photos, settings.force, progress, say))]
    if photos.mask is not None:
        notes.append(said(photos.mask))
        say(f"unchanging  {notes[-1]}")
    poses = place_photos(photos, stages.place, settings, progress, say, 0.0 if settings.force else ENOUGH)
    if not known and not settings.still:
        poses = place_again(poses, photos, stages, settings, progress, say)
    if poses.unmeasured is not None:
        raise poses.unmeasured
    placed = poses.placed
    if placed.up_from == "cameras" and (torn := leap(placed)) is not None:  # with force, the report says both
        unless_forced(f"{torn} No floor was found, either: the scale may be far off.", settings.force, "world", say)
    world = (
        f"world       up from {placed.up_from}, scale from {placed.scale_from}, camera at {placed.camera_height:.2f} m"
    )
    say("\n".join([world, *(f"            {remark}" for remark in placed.remarks)]))
    return placed, [*notes, *poses.remarks, *placed.remarks]


def build_scene(
    placed: Placed,
    folder: Path,
    settings: CaptureSettings,
    notes: Sequence[str] = (),
    progress: Progress = silent,
    say: Say = print,
) -> Quality:
    """Run the second half of a capture: fit Gaussians to what the cameras saw, check them, and write the folder.

    Args:
        placed: the cameras in the world.
        folder: the scene's folder.
        settings: settings of the capture.
        notes: remarks for the report.
        progress: called with the progress of each stage.
        say: called with the outcome of each stage.

    Raises:
        FileExistsError: for an existing scene, without ``force``.
    """
    stages, found = _stages(folder, say), placed.reconstruction
    finely, moving = settings.fit_of(found), None
    depths = kept_depths(found, stages, progress)
    if not settings.still:
        moving = kept_moving(found, depths, stages, finely, progress)
        depths = depths.without(moving)
        if moving.any():
            say(f"moving      {share_of(moving)} of the image area shows moving things and is masked out")
    gaussians = kept_fit(found, depths, stages, finely, progress, say)
    gaussians, carved = without_floaters(gaussians, dense_voxels(gaussians, placed), found)
    size = f"{finely.width} pixels wide, {carved} voxels of floaters removed"
    say(f"fit         {gaussians.numel():,} Gaussians fitted to images {size}")
    unseen = held_out(len(found.paths)).tolist()
    quality = write_scene(
        folder,
        gaussians,
        placed,
        unseen,
        notes=notes,
        force=settings.force,
        known=depths.far(frame_of(found.camera_to_world)),
        splat=settings.splat,
        moving=moving,
        work=stages.place,
        progress=progress,
    )
    say("\n".join([f"check       {_words(quality)}", *(f"            {problem}" for problem in quality.problems)]))
    return quality


def _stages(folder: Path, say: Say) -> Stages:
    return Stages(folder / STAGES, lambda line: say(f"stages      {line}"))


def _first_look(photos: Photos, force: bool, progress: Progress, say: Say) -> list[str]:
    """Refuse a capture that cannot work, or with ``force`` return the reason for the report."""
    covered = None if photos.mask is None else too_much(photos.mask)
    cause = look(photos if covered is None else replace(photos, mask=None), progress).cause() or covered
    if cause is None:
        say("look        no problems found")
        return []
    return [unless_forced(cause, force, "look", say)]


def _words(quality: Quality) -> str:
    pictures = "no image held out" if quality.psnr is None else f"{quality.psnr:.1f} dB on held-out images"
    return f"{pictures}, {100 * quality.path_free:.0f} % of the camera's path is free"
