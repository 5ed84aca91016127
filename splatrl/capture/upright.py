"""Refine the upward direction by what stands upright and lies level in a place."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from splatrl.scenes.walls import entropy

Floats = NDArray[np.float64]

WITHIN, SAMPLED = 0.9, 6000
"""Quantile of the distance from the middle up to which points are used, and about how many of these are sampled."""
FARTHEST, STEP = 10, 1
"""Degrees that are searched around the given direction, beyond its lean, and the step of the search."""
UNSURE, LEANING, UNLIKELY = math.radians(3.0), 0.45, 0.03
"""Usual error of the given direction, radians; the fraction of its lean that adds to it; and the entropy that an error
of that size costs."""
CLEAR = 0.25
"""Minimum gap between the least and the median entropy of the directions searched in a clearly upright place."""
ONE_WAY = math.radians(10.0)
"""Maximum lean of cameras that look all around; these know more than a place that is not clearly upright."""
_YAWS = np.radians(np.arange(0.0, 90.0, 3.0))


class Held(NamedTuple):
    """The upward direction according to the way in which cameras were held.

    Attributes:
        up: [3] unit vector, upwards (away from the earth).
        side: [3] unit vector perpendicular to it, the axis about which it may be wrong: where cameras look one way,
            nothing distinguishes a camera that looks down from ground that slopes away.
        lean: by how much it may be wrong, radians; about 0 for cameras that look all around.
    """

    up: Floats
    side: Floats
    lean: float


def straightened(points: Floats, held: Held) -> tuple[Floats, bool]:
    """Refine up so that walls stand upright and floors lie level.

    Walls and floors put many points at few coordinates along three perpendicular axes, one of them up. So the
    histograms of the points' coordinates are sharpest, with the least entropy, where up is right. The axes about which
    it may be off are searched one after the other. Directions far from how the cameras were held are penalised, and
    where cameras looked all around, a place that is not clearly upright decides nothing.

    Args:
        points: [P, 3].
        held: up according to the cameras.

    Returns:
        Up, [3] unit vector, and whether the place is clearly upright.
    """
    off = points - np.median(points, 0)
    reach = np.linalg.norm(off, axis=1)
    size = float(np.quantile(reach, WITHIN)) or 1.0
    off = off[reach <= size]
    off = off[:: max(1, len(off) // SAMPLED)] / size
    up, gain = _straightest(off, held.up, held.side, held.lean)
    for axis in (np.cross(up, held.side), held.side):
        up, gain = _straightest(off, up, axis, 0.0)
    clear = gain > CLEAR
    return up if clear or held.lean > ONE_WAY else held.up, clear


def _straightest(off: Floats, up: Floats, side: Floats, lean: float) -> tuple[Floats, float]:
    """Return the direction of least entropy when ``up`` turns about an axis, and its gap to the median entropy."""
    side = side - up * (side @ up)
    side = side / np.linalg.norm(side)
    ahead, across = np.cross(up, side), off @ side

    def direction(angle: float) -> Floats:
        return np.asarray(math.cos(angle) * up + math.sin(angle) * ahead)

    def cost(angle: float, yaws: Floats) -> tuple[float, float]:
        """Return the entropy with the floor's axes turned to be as sharp as possible, and their yaw."""
        along = off @ direction(angle + 0.5 * math.pi)
        level = [
            entropy(math.cos(yaw) * along + math.sin(yaw) * across)
            + entropy(math.cos(yaw) * across - math.sin(yaw) * along)
            for yaw in yaws
        ]
        best = int(np.argmin(level))
        far = UNLIKELY * (angle / (UNSURE + LEANING * lean)) ** 2
        return entropy(off @ direction(angle)) + level[best] + far, float(yaws[best])

    most = FARTHEST + round(math.degrees(lean))
    angles = np.radians(np.arange(-most, most + 1, STEP))
    costs, yaws = zip(*(cost(angle, _YAWS) for angle in angles), strict=True)
    least = int(np.argmin(costs))
    finer = angles[least] + np.radians(np.arange(-1.0, 1.01, 0.2))
    near = yaws[least] + np.radians(np.arange(-3.0, 3.01, 0.5))
    angle = float(finer[int(np.argmin([cost(angle, near)[0] for angle in finer]))])
    return direction(angle), float(np.median(costs)) - costs[least]
