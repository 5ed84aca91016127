"""How unevenly the camera of a film went: where a part of it was joined to the others wrongly, it seems to leap."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FEWEST = 38
"""Changes of velocity, those of 40 images; of fewer, one in a hundred says nothing."""


def leaps(places: Floats, seconds: Floats) -> Floats:
    """How large each change of a camera's velocity is, times as large as half of them are at most.

    Args:
        places: [N, 3] of the camera, in any unit.
        seconds: [N], ascending, when it was there.

    Returns:
        [N − 2], of the second place to the last but one.
    """
    velocity = np.diff(places, axis=0) / np.maximum(np.diff(seconds), 1e-3)[:, None]
    changes: Floats = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    return changes / max(float(np.median(changes)), 1e-12) if len(changes) else changes


def jerks(sudden: Floats) -> float:
    """What one of a camera's ``leaps`` in a hundred exceeds; 0 for fewer than ``FEWEST``."""
    return float(np.quantile(sudden, 0.99)) if len(sudden) >= FEWEST else 0.0
