"""Numbers from settings, checked where they come in."""

import math


def require_number(name: str, value: object, low: float, high: float = math.inf, whole: bool = False) -> None:
    """Refuse anything but a finite number in a range.

    Args:
        name: the key, for the message.
        value: what came.
        low: the smallest that is right.
        high: the largest.
        whole: whether it must be an integer.

    Raises:
        ValueError: names the key, the range and what came.
    """
    kinds = (int,) if whole else (int, float)
    right = isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high
    if not (right and math.isfinite(value)):  # type: ignore[arg-type]
        limit = f"of at least {low}" if high == math.inf else f"from {low} to {high}"
        raise ValueError(f"{name}: expected a {'whole number' if whole else 'number'} {limit}, got {value!r}")
