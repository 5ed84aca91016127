"""Limits on the area of a motion and on the number of its states, which settings and a stranger's scene can set."""

import math
from collections.abc import Sequence

from splatrl.values import require_number

MOST_STATES = 2**24
"""Maximum number of states of a motion: planning takes 0.5 to 1.5 kB for each, which makes 9 to 26 GB."""
FARTHEST = 1e9
"""Largest coordinate of a motion's bounds, metres."""


def require_area(lower: Sequence[float], upper: Sequence[float]) -> None:
    """Refuse anything but a lower and an upper corner on the ground, x and y in metres, with an area between them.

    Raises:
        ValueError: names the key and what was given.
    """
    for name, corner in (("lower", lower), ("upper", upper)):
        for value in corner:
            require_number(f"task.motion.{name}", value, -FARTHEST, FARTHEST)
    if len(lower) != 2 or len(upper) != 2 or not all(low < high for low, high in zip(lower, upper, strict=True)):
        raise ValueError(f"task.motion: expected lower < upper in x and y, got {list(lower)} and {list(upper)}")


def values_within(low: float, high: float, step: float) -> int:
    """Return how many values lie from ``low`` to ``high``, ``step`` above 0 apart, beginning with ``low``."""
    return math.floor(min((high - low) / step, 2.0**62) + 1e-6) + 1


def require_few(
    counts: Sequence[int],
    where: str = "",
    what: str = "states",
    remedy: str = "choose a larger step or a smaller area",
) -> None:
    """Refuse more than ``MOST_STATES`` combinations, before memory is allocated for them.

    Args:
        counts: number of values along each axis.
        where: the range of the values and their steps, after a space, for the message.
        what: what the combinations are, in the plural.
        remedy: what to change.

    Raises:
        ValueError: names the limit, the counts and what to change.
    """
    if (product := math.prod(counts)) > MOST_STATES:
        got = f"{product:,} ({' × '.join(f'{count:,}' for count in counts)}){where}"
        raise ValueError(f"task.motion: expected at most {MOST_STATES:,} {what}, got {got}; {remedy}")
