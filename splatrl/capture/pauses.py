"""Pauses of a film, in which its clock stands still, so that they cost no images.

The recorder may have been paused, which shows in the times of the frames. Or the camera stood still, on a tripod or in
a hand: then it shows one view for long. Two frames show the same view where most edges stay what they were; so a hand
may sway, the light may change, and a person may walk through.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Floats = NDArray[np.float64]

STEP = 0.25
"""Maximum time from one frame to the next that counts, seconds."""
LONGEST = 32
"""Longer side of the images in which views are compared, pixels: so few that a hand which sways by half a degree moves
edges by a fraction of a pixel."""
EDGES, SAME = 1 / 3, 0.7
"""Fraction of the pixels that are taken for edges, and the maximum change of these in one view: of their gradient,
relative to it, median. Edges of another view change by 1, and those seen by a hand that sways by 0.4° (standard
deviation) by at most 0.7."""
STILL = 2.0
"""Time that counts of a longer view, seconds. Films of walks and turns show no view for more than 1.1 s."""


def small(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a grey image [H, W] of at most ``LONGEST`` pixels along its longer side, [h, w], to compare views."""
    scale = min(1.0, LONGEST / max(grey.shape))
    height, width = (max(2, round(side * scale)) for side in grey.shape)
    return np.asarray(Image.fromarray(grey).resize((width, height), Image.Resampling.BOX))


def views(seconds: Sequence[float], smalls: Sequence[NDArray[np.uint8]]) -> list[float]:
    """Return the times at which the V views of a film begin, the first one included.

    Args:
        seconds: N times of the film's frames, ascending; those that show nothing may be missing.
        smalls: the ``small`` image of each.
    """
    begun: list[float] = []
    view: Floats | None = None
    for second, image in zip(seconds, smalls, strict=True):
        slopes = np.stack([*np.gradient(image.astype(np.float64))], -1)
        if view is None or _change(view, slopes) >= SAME:
            begun.append(second)
            view = slopes
    return begun


def without_pauses(times: Floats, begun: Sequence[float]) -> Floats:
    """Return the times of a film's frames by a clock that stands still in pauses, [N]; ``times`` itself without any.

    Args:
        times: [N] seconds, ascending.
        begun: V times at which another view begins; empty where they are unknown.
    """
    clock, steps = times, np.diff(times)
    if (steps > STEP).any():
        clock = times[0] + np.append(0.0, np.cumsum(np.minimum(steps, STEP)))
    first = np.append(0, np.searchsorted(times[:-1], begun))  # frame of each view; what comes before shows nothing
    lengths = np.diff(np.append(clock[first], clock[-1]))
    if not len(begun) or (lengths <= STILL).all():
        return clock
    starts = np.append(0.0, np.cumsum(np.minimum(lengths, STILL))[:-1])
    view = np.searchsorted(first, np.arange(len(times)), side="right") - 1
    return np.asarray(clock[0] + starts[view] + np.minimum(clock - clock[first][view], STILL))


def _change(before: Floats, after: Floats) -> float:
    """Return how much the edges of an image change, given the slopes of its grey levels, [h, w, 2] both."""
    strength = np.maximum(np.linalg.norm(before, axis=-1), 1e-9)
    edges = strength >= np.quantile(strength, 1 - EDGES)
    return float(np.median(np.linalg.norm((after - before)[edges], axis=-1) / strength[edges]))
