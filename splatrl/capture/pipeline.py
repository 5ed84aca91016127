"""All stages of a capture, one after the other; each keeps its result, so that a second call continues.

Longer than other modules, since both halves of a capture look for moving things: the first to find poses without them,
the second to fit the place without them.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch

from splatrl.capture.area import dense_voxels
from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.check import Quality
from splatrl.capture.depth_points import with_measured_points
from splatrl.capture.drift import leap
from splatrl.capture.fit import FitSettings, fit, held_out, trained
from splatrl.capture.fit_checkpoint import CHECKPOINT, Checkpoint
from splatrl.capture.fit_pictures import frame_of
from splatrl.capture.floaters import without_floaters
from splatrl.capture.folder import share_of, write_scene
from splatrl.capture.frames import read_photos
from splatrl.capture.look import look
from splatrl.capture.mapping import ENOUGH, NEARLY
from splatrl.capture.marker import MARKER_SIDE
from splatrl.capture.masks import in_view, masks_of, write_masks
from splatrl.capture.moving import find_moving, small_fit
from splatrl.capture.poses import check_libraries, find_poses
from splatrl.capture.progress import Progress, silent
from splatrl.capture.quarters import how_turned
from splatrl.capture.recordings import is_recording, read_recording
from splatrl.capture.resolution import Resolution
from splatrl.capture.scale import Distance
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.stereo import Depths, find_depths
from splatrl.capture.unchanging import left_out_at, said, too_much, with_mask
from splatrl.capture.upright_check import why_not_upright
from splatrl.capture.world import FEWEST, Placed, place
from splatrl.capture.zoom import REFUSED, zoomed
from splatrl.files import alone_in, remove_stale, require_room
from splatrl.native import _core
from splatrl.scenes import Gaussians, read_gaussians, write_gaussians
from splatrl.scenes.description import SCENE_FILE, SMALL_SPLAT, SPLAT, check_absent

STAGES = "stages"
"""Sub-folder of a capture in which the stages keep their results; it can be deleted once the scene is there."""
FITTED = "gaussians.ply"
MASKS = ("masks", "masks_2")
"""Folders with masks of what moves; with each, poses are found once more if it masks more than the one before."""
IN_VIEW = "people or things that move were in view in {:.0f} % of the images"


@dataclass(frozen=True)
class CaptureSettings:
    """Settings of a capture.

    Attributes:
        count: minimum and maximum number of images that are taken from a video.
        longest: maximum pixels along the longer side of these images.
        force: whether to go on with a capture that a first look refuses, or without the images that cannot be joined,
            and to replace an existing scene.
        seed: seed of everything that is random.
        camera_height: mean height of the camera above the floor, metres, where that sets the scale.
        distance: distance between two points in images, where that sets the scale.
        marker: side of a printed marker's black square, metres.
        splat: name of the splat file in the scene's folder; one that ends in .spz is small.
        fit: settings of the fit.
        still: whether nothing moved while it was filmed, so that moving things need not be looked for.
        resolution: sets the width and the cap of the fit by the robots' image size; None takes those of ``fit``.
    """

    count: tuple[int, int] = (120, 200)
    longest: int = 960
    force: bool = False
    seed: int = 0
    camera_height: float | None = None
    distance: Distance | None = None
    marker: float = MARKER_SIDE
    splat: str = SPLAT
    fit: FitSettings = field(default_factory=FitSettings)
    still: bool = False
    resolution: Resolution | None = None


@dataclass(frozen=True)
class _Poses:
    """Poses that were found, and brought to the world.

    Attributes:
        placed: the cameras in the world.
        remarks: remarks for the report.
        unmeasured: why the stated distance cannot be measured in their images. It may have been clicked in those of
            poses that are found later, so this is an error only where none follow.
    """

    placed: Placed
    remarks: list[str]
    unmeasured: CaptureError | None = None

    @property
    def doubt(self) -> int:
        """0 where the camera does not seem to leap, 1 where it does, and 2 where no floor was found, either."""
        return 0 if leap(self.placed) is None else 2 if self.placed.up_from == "cameras" else 1

    def worse(self, before: "_Poses") -> str | None:
        """Return in what these poses are worse than those before; None where they are not."""
        if len(self.placed.reconstruction.paths) < NEARLY * len(before.placed.reconstruction.paths):
            return "too few images"
        return leap(self.placed) if self.doubt > before.doubt else None


def capture(
    source: Path,
    folder: Path,
    settings: CaptureSettings,
    progress: Progress = silent,
    say: Callable[[str], object] = print,
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
    say: Callable[[str], object] = print,
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
    stages = folder / STAGES
    stages.mkdir(parents=True, exist_ok=True)
    known = is_recording(source)
    if known:
        photos = read_recording(source, stages, settings.count, settings.longest, progress)
    else:
        photos = read_photos(source, stages, settings.count, settings.longest, progress)
    knows = f", with poses{' and depth' if photos.depths else ''}" if known else ""
    frames = f"frames      {len(photos.paths)} of {photos.width} × {photos.height} pixels{knows}"
    say("\n".join([frames, *(f"            {remark}" for remark in photos.remarks)]))
    photos = with_mask(photos, stages, progress)
    notes = [*photos.remarks, *([] if known else _first_look(photos, settings.force, progress, say))]
    if photos.mask is not None:
        notes.append(said(photos.mask))
        say(f"unchanging  {notes[-1]}")
    poses = _placed(photos, stages, settings, progress, say, 0.0 if settings.force else ENOUGH)
    if not known and not settings.still:
        poses = _placed_again(poses, photos, stages, settings, progress, say)
    if poses.unmeasured is not None:
        raise poses.unmeasured
    placed = poses.placed
    if placed.up_from == "cameras" and (torn := leap(placed)) is not None:  # with force, the report says both
        _unless_forced(f"{torn} No floor was found, either: the scale may be far off.", settings.force, "world", say)
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
    say: Callable[[str], object] = print,
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
    stages = Stages(folder / STAGES, lambda line: say(f"stages      {line}"))
    frame = frame_of(placed.reconstruction.camera_to_world)
    finely, moving = _finely(placed, settings), None
    depths = _depths(placed, stages, progress)
    if not settings.still:
        moving = _moving(placed, depths, stages, finely, progress)
        depths = depths.without(moving)
        if moving.any():
            say(f"moving      {share_of(moving)} of the image area shows moving things and is masked out")
    gaussians = _fitted(placed, depths, stages, finely, progress, say)
    gaussians, carved = without_floaters(gaussians, dense_voxels(gaussians, placed), placed.reconstruction)
    size = f"{finely.width} pixels wide, {carved} voxels of floaters removed"
    say(f"fit         {gaussians.numel():,} Gaussians fitted to images {size}")
    unseen = held_out(len(placed.reconstruction.paths)).tolist()
    quality = write_scene(
        folder,
        gaussians,
        placed,
        unseen,
        notes=notes,
        force=settings.force,
        known=depths.far(frame),
        splat=settings.splat,
        moving=moving,
        work=stages.place,
        progress=progress,
    )
    say("\n".join([f"check       {_words(quality)}", *(f"            {problem}" for problem in quality.problems)]))
    return quality


def _first_look(photos: Photos, force: bool, progress: Progress, say: Callable[[str], object]) -> list[str]:
    """Refuse a capture that cannot work, or with ``force`` return the reason for the report."""
    covered = None if photos.mask is None else too_much(photos.mask)
    cause = look(photos if covered is None else replace(photos, mask=None), progress).cause() or covered
    if cause is None:
        say("look        no problems found")
        return []
    return [_unless_forced(cause, force, "look", say)]


def _unless_forced(cause: str, force: bool, stage: str, say: Callable[[str], object]) -> str:
    """Refuse a capture for this cause, or with ``force`` print the cause and return it for the report."""
    if not force:
        raise CaptureError(f"{cause} Pass --force to continue anyway.")
    say(f"{stage:<11} {cause}")
    return cause


def _placed(
    photos: Photos,
    stages: Path,
    settings: CaptureSettings,
    progress: Progress,
    say: Callable[[str], object],
    least: float,
) -> _Poses:
    """Find the poses of the photos, and bring them to the world."""
    found, remarks = with_measured_points(find_poses(photos, stages, settings.seed, progress, least=least)), []
    lost = f"\n            missing: {', '.join(found.lost)}" if found.lost else ""
    say(f"poses       {len(found.paths)} of {len(photos.paths)} images, {len(found.points):,} points{lost}")
    if photos.camera_to_world is not None and len(found.paths) > 1 and len(found.points) < FEWEST:
        raise CaptureError(
            f"only {len(found.points)} points agree with the recorded poses, expected at least {FEWEST}: do the poses "
            "belong to these images, and do the images show texture?"
        )
    if photos.up is None and (rotated := why_not_upright(found, photos)) is not None:
        remarks.append(_unless_forced(rotated, settings.force, "poses", say))
    if photos.up is None and (turned := how_turned(found)) is not None:
        remarks.append(_unless_forced(turned, True, "poses", say))
    if (changed := zoomed(found)) is not None:
        slightly = zoomed(found, REFUSED) is None
        remarks.append(_unless_forced(changed, settings.force or slightly, "poses", say))

    def by(distance: Distance | None) -> Placed:
        stated = settings.marker, distance, settings.camera_height
        return place(found, photos.up, photos.metric, *stated, progress=progress)

    try:
        return _Poses(by(settings.distance), remarks)
    except CaptureError as error:
        if settings.distance is None:
            raise
        return _Poses(by(None), remarks, error)


def _placed_again(
    first: _Poses,
    photos: Photos,
    stages: Path,
    settings: CaptureSettings,
    progress: Progress,
    say: Callable[[str], object],
) -> _Poses:
    """Find the poses again without what moves, while much of that is found and the poses are no worse for it.

    See ``_placed``.
    """
    chain, seen, kept = [first], "", Stages(stages, lambda line: say(f"stages      {line}"))

    def keep(why: object) -> None:
        say(f"poses       without what moves: {why}\n            The poses before are kept.")

    for name in MASKS:
        try:
            masks = _masks(name, chain[-1].placed, photos, kept, settings, progress)
        except CaptureError as error:  # the fit would fail like the search
            if len(chain) == 1:
                raise
            keep(error)
            chain.pop()
            break
        share = in_view(masks)
        if share is None:
            break
        seen, photos = IN_VIEW.format(100 * share), replace(photos, moving=masks)
        say(f"moving      {seen}: poses are found again without them")
        try:
            again = _placed(photos, stages, settings, progress, say, 0.0)
        except CaptureError as error:
            keep(error)
            break
        if (worse := again.worse(chain[-1])) is not None:
            keep(worse)
            break
        chain.append(again)
    measured = [poses for poses in chain if poses.unmeasured is None]
    last = measured[-1] if measured else chain[-1]
    if last is not chain[-1]:
        keep(chain[-1].unmeasured)
    if seen and last.placed.remarks:
        doubt = f"{seen.capitalize()}, which may be why the ground seems so."
        last = replace(last, placed=replace(last.placed, remarks=(*last.placed.remarks, doubt)))
    return last


def _masks(
    name: str, placed: Placed, photos: Photos, stages: Stages, settings: CaptureSettings, progress: Progress
) -> Path:
    """Return a folder with a mask of what moves in each photo, made once and kept; empty where little more moves."""
    found, finely = placed.reconstruction, _finely(placed, settings)

    def write(made: Path) -> None:
        moving = _moving(placed, _depths(placed, stages, progress), stages, finely, progress)
        if (masks := masks_of(moving, found, photos)) is not None:
            write_masks(made, masks, photos)

    cameras = [found.K, found.seen_point, found.seen_by]  # whatever the scale: one stated later keeps the poses
    return stages.folder(name, fingerprint(_recipe(small_fit(finely, found.width)), cameras, found.paths), write)


def _finely(placed: Placed, settings: CaptureSettings) -> FitSettings:
    resolution = settings.resolution
    return settings.fit if resolution is None else resolution.of(placed.reconstruction, settings.fit)


def _depths(placed: Placed, stages: Stages, progress: Progress) -> Depths:
    """Return the depths of the photos' pixels without those that never change, found once and kept."""
    found, rows = placed.reconstruction, trained(len(placed.reconstruction.paths))

    def find() -> dict[str, torch.Tensor]:
        depths = find_depths(found, frame_of(found.camera_to_world), rows, progress=progress)
        return {"likely": depths.likely, "known": depths.known}

    depths = Depths(**stages.arrays("depths", _key(found), find))
    unchanged = left_out_at(found, *depths.known.shape[1:])
    return depths if unchanged is None else depths.without(unchanged.expand_as(depths.known))


def _moving(placed: Placed, depths: Depths, stages: Stages, settings: FitSettings, progress: Progress) -> torch.Tensor:
    """Return where the photos show moving things, found once and kept."""
    found = placed.reconstruction

    def find() -> dict[str, torch.Tensor]:
        return {"moving": find_moving(found, depths, settings, progress)}

    return stages.arrays("moving", _key(found, small_fit(settings, found.width), depths.moving), find)["moving"]


def _fitted(
    placed: Placed,
    depths: Depths,
    stages: Stages,
    settings: FitSettings,
    progress: Progress,
    say: Callable[[str], object],
) -> Gaussians:
    """Return the Gaussians of a placed reconstruction, fitted once and kept; a fit that was killed resumes."""
    key = _key(placed.reconstruction, settings, depths.moving)

    def write(made: Path) -> None:
        rounding = f"{torch.device(settings.device).type} {_core.isa()}"
        work = stages.workplace("fitting", fingerprint([key, rounding]))
        checkpoint = Checkpoint(work / CHECKPOINT, say=lambda line: say(f"fit         {line}"))

        def tell(done: int, total: int, loss: float) -> None:
            progress("fit", done, total)

        write_gaussians(made / FITTED, fit(placed.reconstruction, settings, tell, depths, checkpoint))

    kept = stages.folder("fit", key, write)
    stages.discard("fitting")
    return read_gaussians(kept / FITTED)  # so that a second call returns the same bytes


def _key(found: Reconstruction, settings: FitSettings | None = None, moving: torch.Tensor | None = None) -> str:
    """Return a fingerprint of everything that depths, or with settings a fit that masks moving things, depend on."""
    recipe = {} if settings is None else _recipe(settings)
    tensors = [found.K, found.camera_to_world, found.points, found.colors, found.seen_point, found.seen_by]
    masked = [] if moving is None or not moving.any() else [moving]
    return fingerprint([recipe, found.depth_unit], tensors + masked, (*found.paths, *found.depths))


def _recipe(settings: FitSettings) -> dict[str, object]:
    return asdict(settings) | {"threads": None, "device": None}


def _words(quality: Quality) -> str:
    pictures = "no image held out" if quality.psnr is None else f"{quality.psnr:.1f} dB on held-out images"
    return f"{pictures}, {100 * quality.path_free:.0f} % of the camera's path is free"
