"""Where the cameras were: poses of photos, brought to a world that stands upright, in metres."""

from dataclasses import dataclass
from pathlib import Path

from splatrl.capture.base import CaptureError, Photos, unless_forced
from splatrl.capture.depth_points import with_measured_points
from splatrl.capture.poses import find_poses
from splatrl.capture.progress import Progress, Say
from splatrl.capture.quarters import how_turned
from splatrl.capture.scale import Distance
from splatrl.capture.settings import CaptureSettings
from splatrl.capture.sfm.fisheye import straightened
from splatrl.capture.sfm.zoom import REFUSED, zoomed
from splatrl.capture.upright_check import why_not_upright
from splatrl.capture.world import FEWEST, Placed, place


@dataclass(frozen=True)
class Poses:
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


def place_photos(
    photos: Photos,
    folder: Path,
    settings: CaptureSettings,
    progress: Progress,
    say: Say,
    least: float,
) -> Poses:
    """Find the poses of photos, and bring them to the world.

    Args:
        photos: the photos.
        folder: where structure from motion works.
        settings: settings of the capture.
        progress: called with the progress of the search.
        say: called with its outcome.
        least: minimum fraction of the photos that must get a pose.

    Raises:
        CaptureError: for photos whose poses cannot be found, or seem wrong.
    """
    found, remarks = with_measured_points(find_poses(photos, folder, settings.seed, progress, least=least)), []
    lost = f"\n            missing: {', '.join(found.lost)}" if found.lost else ""
    say(f"poses       {len(found.paths)} of {len(photos.paths)} images, {len(found.points):,} points{lost}")
    if photos.camera_to_world is not None and len(found.paths) > 1 and len(found.points) < FEWEST:
        raise CaptureError(
            f"only {len(found.points)} points agree with the recorded poses, expected at least {FEWEST}: do the poses "
            "belong to these images, and do the images show texture?"
        )
    if photos.up is None and (rotated := why_not_upright(found, photos)) is not None:
        remarks.append(unless_forced(rotated, settings.force, "poses", say))
    if photos.up is None and (turned := how_turned(found)) is not None:
        remarks.append(unless_forced(turned, True, "poses", say))
    if (bent := straightened(found)) is not None:
        remarks.append(unless_forced(bent, True, "poses", say))
    if (changed := zoomed(found)) is not None:
        slightly = zoomed(found, REFUSED) is None
        remarks.append(unless_forced(changed, settings.force or slightly, "poses", say))

    def by(distance: Distance | None) -> Placed:
        stated = settings.marker, distance, settings.camera_height
        return place(found, photos.up, photos.metric, *stated, progress=progress)

    try:
        return Poses(by(settings.distance), remarks)
    except CaptureError as error:
        if settings.distance is None:
            raise
        return Poses(by(None), remarks, error)
