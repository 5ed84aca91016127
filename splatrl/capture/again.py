"""Poses found again without the people and things that move, where these fill much of the photos (see ``masks``)."""

from dataclasses import replace
from pathlib import Path

from splatrl.capture.base import CaptureError, Photos, Reconstruction
from splatrl.capture.drift import below_floor, leap
from splatrl.capture.kept import kept_depths, kept_moving, recipe_of
from splatrl.capture.masks import in_view, masks_of, write_masks
from splatrl.capture.moving import small_fit
from splatrl.capture.placing import Poses, place_photos
from splatrl.capture.progress import Progress, Say
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.mapping import NEARLY
from splatrl.capture.stages import Stages, fingerprint
from splatrl.capture.world import Placed

MASKS = ("masks", "masks_2")
"""Folders with masks of what moves; with each, poses are found once more if it masks more than the one before."""
IN_VIEW = "people or things that move were in view in {:.0f} % of the images"


def place_again(
    first: Poses,
    photos: Photos,
    stages: Stages,
    settings: CaptureSettings,
    progress: Progress,
    say: Say,
) -> Poses:
    """Find the poses again without what moves, while much of that is found and the poses are no worse for it.

    Args:
        first: the poses that were found with everything in view.
        photos: the photos.
        stages: where poses and masks are kept.
        settings: settings of the capture.
        progress: called with the progress of each search.
        say: called with the outcome of each.

    Raises:
        CaptureError: where moving things cannot be sought.
    """
    chain, seen = [first], ""

    def keep(why: object) -> None:
        say(f"poses       without what moves: {why}\n            The poses before are kept.")

    for name in MASKS:
        try:
            masks = _masks(name, chain[-1].placed.reconstruction, photos, stages, settings, progress)
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
            again = place_photos(photos, stages.place, settings, progress, say, 0.0)
        except CaptureError as error:
            keep(error)
            break
        if (worse := _worse(again, chain[-1])) is not None:
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
    name: str, found: Reconstruction, photos: Photos, stages: Stages, settings: CaptureSettings, progress: Progress
) -> Path:
    """Return a folder with a mask of what moves in each photo, made once and kept; empty where little more moves."""
    finely = settings.fit_of(found)

    def write(made: Path) -> None:
        moving = kept_moving(found, kept_depths(found, stages, progress), stages, finely, progress)
        if (masks := masks_of(moving, found, photos)) is not None:
            write_masks(made, masks, photos)

    cameras = [found.K, found.seen_point, found.seen_by]  # whatever the scale: one stated later keeps the poses
    return stages.folder(name, fingerprint(recipe_of(small_fit(finely, found.width)), cameras, found.paths), write)


def _worse(again: Poses, before: Poses) -> str | None:
    """Return in what poses are worse than those before; None where they are not."""
    if len(again.placed.reconstruction.paths) < NEARLY * len(before.placed.reconstruction.paths):
        return "too few images"
    return _torn(again.placed) if _doubt(again.placed) > _doubt(before.placed) else None


def _torn(placed: Placed) -> str | None:
    """Return a warning where parts of a film seem to have been joined wrongly; None where nothing suggests that."""
    return leap(placed) or below_floor(placed)


def _doubt(placed: Placed) -> int:
    """Return 0 where nothing seems to be joined wrongly, 1 where it does, and 2 where no floor was found, either."""
    return 0 if _torn(placed) is None else 2 if placed.up_from == "cameras" else 1
