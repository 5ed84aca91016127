"""How unevenly the camera of a film moved: where a part was joined wrongly to the rest, it seems to leap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from splatrl.capture.cuts import takes

if TYPE_CHECKING:  # the process that runs COLMAP needs no PyTorch, whose import takes seconds
    from splatrl.capture.base import Reconstruction

Floats = NDArray[np.float64]

TORN = 8.0
"""Jerk from which a camera's path counts as torn: twice the jerk above which a film is mapped a second way."""
MOVING = 0.25
"""Minimum speed of a camera that walks, as a fraction of its 90th percentile. Velocities below it are mostly noise of
the poses, and a film that stands still for half its length has no others in most of its images."""
FEWEST = 38
"""Minimum number of velocity changes, those of 40 images; with fewer, the 99th percentile says nothing."""


def leaps(places: Floats, seconds: Floats, cuts: Sequence[float] = ()) -> Floats:
    """Return the size of each change of a camera's velocity, relative to the median change while it moves.

    From one take of a film to the next, the camera may be carried anywhere, which is no leap.

    Args:
        places: [N, 3] positions of the camera, in any unit.
        seconds: [N] times at which it was there, ascending.
        cuts: times at which another take begins.

    Returns:
        [N − 2], for the second position to the last but one; 0 where the positions around it are of several takes.
    """
    take = takes(seconds, cuts)
    whole = take[2:] == take[:-2]
    if not whole.any():
        return np.zeros(len(whole))
    velocity = np.diff(places, axis=0) / np.maximum(np.diff(seconds), 1e-3)[:, None]
    changes: Floats = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    usual = np.quantile(speed[np.append(whole, False) | np.append(False, whole)], 0.9)
    moves = whole & (np.maximum(speed[1:], speed[:-1]) >= MOVING * usual)
    return np.where(whole, changes / max(float(np.median(changes[moves])), 1e-12), 0.0)


def camera_leaps(found: Reconstruction) -> Floats:
    """Return the ``leaps`` of a film's camera, [N − 2]; empty where the capture times are unknown."""
    if found.seconds is None:
        return np.zeros(0)
    return leaps(found.camera_to_world[:, :3, 3].numpy(), found.seconds.numpy(), found.cuts)


def jerks(sudden: Floats) -> float:
    """Return the 99th percentile of a camera's ``leaps``, [N − 2]; 0 for fewer than ``FEWEST``."""
    return float(np.quantile(sudden, 0.99)) if len(sudden) >= FEWEST else 0.0
