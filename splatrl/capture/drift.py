"""Whether a reconstruction keeps its scale from the beginning of a film to its end, and is not bent within."""

from itertools import pairwise

import numpy as np

from splatrl.capture.ground import lowest_level
from splatrl.capture.jerks import Floats, jerks, leaps
from splatrl.capture.world import Placed

PARTS = 8
"""Of a film, in each of which the camera's height above the floor is measured."""
LOWEST, LEAST, LEVEL = 0.12, 40, 0.5
"""Share of the points of a part, the lowest, that may be its floor; how many must lie level, and their share."""
SEEN = 3
"""Cameras of a part that saw such a point, at least."""
MOST = 3.0
"""Ratio of two heights; tables and steps in the picture make it 2.3 in captures that are right."""
TORN = 8.0
"""Jerks of a camera's path, at least: twice those for which a film is mapped a second way."""


def leap(placed: Placed) -> str | None:
    """What says that a film was joined wrongly somewhere; None where nothing does.

    Where bare walls or blur leave few points, what was seen before and after is hinged on these, and may turn.

    Args:
        placed: cameras and points in the world.
    """
    sudden, seconds = camera_leaps(placed), placed.reconstruction.seconds
    if seconds is None or jerks(sudden) < TORN:
        return None
    most = int(sudden.argmax())
    when = float(seconds[most + 1])
    return (
        f"The camera seems to leap at {when:.0f} s, by {sudden[most]:.0f} times what it usually does: "
        "what it saw before and after may be joined wrongly. Film that part again, more slowly and with more in view."
    )


def camera_leaps(placed: Placed) -> Floats:
    """The ``leaps`` of a film's camera; none where nothing says when its images were taken."""
    found = placed.reconstruction
    if found.seconds is None:
        return np.zeros(0)
    return leaps(found.camera_to_world[:, :3, 3].numpy(), found.seconds.numpy())


def lost_scale(placed: Placed) -> str | None:
    """What says that two parts of a film have scales of their own; None where nothing does.

    Where somebody turns around on the spot no point is seen from two sides, and nothing carries the scale on.

    Args:
        placed: cameras and points in the world.
    """
    heights = _heights(placed)
    if not heights:
        return None
    (low, least), (high, most) = min(heights, key=lambda part: part[1]), max(heights, key=lambda part: part[1])
    if most < MOST * least:
        return None
    seconds = placed.reconstruction.seconds
    places = [f"image {row}" if seconds is None else f"{float(seconds[row]):.0f} s" for row in (high, low)]
    return (
        f"The camera seems {most:.2f} m above the floor at {places[0]} and {least:.2f} m at {places[1]}: the scale was "
        "lost in between, as by turning around on the spot. Film it again and turn in a wide arc, or cut one part out."
    )


def _heights(placed: Placed) -> list[tuple[int, float]]:
    """The middle camera of each part that shows its floor, and how high above that floor the part's cameras were."""
    found = placed.reconstruction
    cameras, points = found.camera_to_world[:, 2, 3].numpy(), found.points[:, 2].numpy()
    seen_by, seen_point = found.seen_by.numpy(), found.seen_point.numpy()
    edges = np.linspace(0, len(cameras), PARTS + 1).astype(int).tolist()
    heights = []
    for first, last in pairwise(edges):
        times = np.bincount(seen_point[(seen_by >= first) & (seen_by < last)], minlength=len(points))
        near = points[times >= SEEN]
        if len(near) < LEAST:
            continue
        low = near[near <= np.quantile(near, LOWEST)]
        level, count = lowest_level(low, cameras[first:last])
        above = float(np.median(cameras[first:last])) - level
        if count >= max(LEAST, LEVEL * len(low)) and above > 0:
            heights.append(((first + last) // 2, above))
    return heights
