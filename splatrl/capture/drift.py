"""Drift of a reconstruction: whether its scale changes from one part of a film to another, and whether it is bent."""

from itertools import pairwise

import numpy as np

from splatrl.capture.beneath import AROUND, from_path, sunk
from splatrl.capture.carrying import weakest
from splatrl.capture.ground import lowest_level
from splatrl.capture.jerks import TORN, camera_leaps, jerks
from splatrl.capture.world import Placed

UP = np.array([0.0, 0.0, 1.0])
PARTS = 8
"""Number of parts of a film; the camera's height above the floor is measured in each."""
LOWEST, LEAST, LEVEL = 0.12, 40, 0.5
"""Fraction of a part's points, the lowest ones, that may belong to its floor; the minimum number of these that must lie
level; and the minimum fraction of these that must."""
SEEN = 3
"""Minimum number of the part's cameras that must have seen such a point."""
LOWER = 0.1
"""Depth below the floor, in heights of the cameras, of a place that is not the floor of a part far from it."""
MOST = 3.0
"""Ratio of two parts' heights from which the scale counts as lost; tables and steps in view raise it to 2.3 in captures
that are right."""


def leap(placed: Placed) -> str | None:
    """Return a warning where a film seems to have been joined wrongly; None where nothing suggests that.

    Where bare walls or blur leave few points, these act as a hinge, about which what was seen before and after may turn
    relative to each other.

    Args:
        placed: cameras and points in the world.
    """
    sudden, seconds = camera_leaps(placed.reconstruction), placed.reconstruction.seconds
    if seconds is None or jerks(sudden) < TORN:
        return None
    most = int(sudden.argmax())
    when = float(seconds[most + 1])
    return (
        f"The camera seems to jump at {when:.0f} s, where its velocity changes {sudden[most]:.0f} times as much as "
        "usual: unless two takes were put together there, the parts before and after may be joined wrongly. Film that "
        "part again, more slowly and with more in view."
    )


def below_floor(placed: Placed) -> str | None:
    """Return a warning where the camera seems to go below a floor that is seen there; None where it does not.

    No camera can. A map that is bent agrees with its own images, and its camera moves evenly: only a path that falls
    by the camera's own height shows it.

    Args:
        placed: cameras and points in the world.
    """
    found = placed.reconstruction
    centers, points = found.camera_to_world[:, :3, 3].numpy(), found.points.numpy()
    below = sunk(centers, points, UP, 0.0, placed.camera_height)
    if not below.any():
        return None
    return (
        f"The camera seems to go below the floor at {_when(placed, int(below.argmax()))}: parts of the place are "
        "joined wrongly, what was taken for the floor is none, or steps lead down beside it, as into a cellar. Film it "
        "again, more slowly, with more in view and without such steps."
    )


def lost_scale(placed: Placed) -> str | None:
    """Return a warning where two parts of a film have different scales; None where nothing suggests that.

    While a camera turns on the spot, no point is seen from two places, and so the scale is not carried on.

    Args:
        placed: cameras and points in the world.
    """
    heights = _heights(placed)
    if not heights:
        return None
    (low, least), (high, most) = min(heights, key=lambda part: part[1]), max(heights, key=lambda part: part[1])
    if most < MOST * least:
        return None
    places = [_when(placed, row) for row in (high, low)]
    return (
        f"The camera seems {most:.2f} m above the floor at {places[0]} and {least:.2f} m at {places[1]}: the scale was "
        "lost in between, for example by turning on the spot. Film it again and turn in wide arcs, or cut one part out."
    )


def weak_scale(placed: Placed) -> str | None:
    """Return a warning where hardly anything carries the scale on; None where nothing suggests that.

    Args:
        placed: cameras and points in the world.
    """
    found = weakest(placed.reconstruction)
    if found is None:
        return None
    when, share = found
    return (
        f"The parts before and after {when:.0f} s may differ in scale: only {100 * share:.0f} % as many points as an "
        "image shows were measured from both. Film that part again, more slowly and sharply, sideways rather than "
        "turning, and with more in view; or cut one part out."
    )


def _when(placed: Placed, row: int) -> str:
    """Return when an image was taken, in words, or its number where that is unknown."""
    seconds = placed.reconstruction.seconds
    return f"image {row}" if seconds is None else f"{float(seconds[row]):.0f} s"


def _heights(placed: Placed) -> list[tuple[int, float]]:
    """For each part that shows its floor, return its middle camera and the cameras' median height above that floor.

    A place far below the path, as seen from a terrace, is no part's floor.
    """
    found, above = placed.reconstruction, placed.camera_height
    cameras, points = found.camera_to_world[:, 2, 3].numpy(), found.points[:, 2].numpy()
    away = from_path(found.camera_to_world[:, :3, 3].numpy(), found.points.numpy(), UP)
    points = np.where((points < -LOWER * above) & (away > AROUND * above), np.nan, points)
    seen_by, seen_point = found.seen_by.numpy(), found.seen_point.numpy()
    edges = np.linspace(0, len(cameras), PARTS + 1).astype(int).tolist()
    heights = []
    for first, last in pairwise(edges):
        times = np.bincount(seen_point[(seen_by >= first) & (seen_by < last)], minlength=len(points))
        near = points[(times >= SEEN) & ~np.isnan(points)]
        if len(near) < LEAST:
            continue
        low = near[near <= np.quantile(near, LOWEST)]
        level, count = lowest_level(low, cameras[first:last])
        above = float(np.median(cameras[first:last])) - level
        if count >= max(LEAST, LEVEL * len(low)) and above > 0:
            heights.append(((first + last) // 2, above))
    return heights
